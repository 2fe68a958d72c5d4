"""Programs: traced once, compiled by the first thread that needs them, and kept while there is room."""

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, final

import jax

from aleator._core.beside import undisturbed

Executable = Callable[..., Any]

# Enough for a session's problems; beyond, the least recently used one is dropped, with the classes it holds.
_KEPT = 256

# Memory mappings that one program takes at most, with what JAX compiles beside it.
_MOST_OF_ONE = 1000

# Linux limits the mappings of each process, and compiled code takes hundreds: beyond, LLVM gets no memory and ends the
# process without a message.
_OWN, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


@final
class Program:
    """A program that is traced in the thread that asks for it, and compiled by the first one that needs it.

    Other threads wait meanwhile. Nothing waits for a core: if another thread was to compile a program and has not
    begun, its caller compiles it. What fails is tried again by the next one who asks.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._compile: Callable[[], Executable] | None = None
        self._executable: Executable | None = None

    @property
    def is_ready(self) -> bool:
        """Whether it has been compiled."""
        return self._executable is not None

    def trace(self, build: Callable[[], Callable[[], Executable]]) -> None:
        """Trace it unless this has been done: `build` returns the function that compiles it."""
        with self._lock:
            if self._compile is None and self._executable is None:
                self._compile = build()

    def __call__(self) -> Executable:
        """The executable of a traced program, compiled now if it has not been."""
        # After Ctrl-C, XLA would go on compiling, and a process that ends meanwhile is aborted.
        return self._executable or undisturbed(self._compiled)

    def _compiled(self) -> Executable:
        with self._lock:
            if self._executable is None:
                assert self._compile is not None
                PROGRAMS.make_room()
                self._executable = self._compile()
                self._compile = None  # with what it holds
            return self._executable


@final
class Programs:
    """Programs by their keys; the least recently used are dropped if there are too many.

    `most` bounds their number. So do the memory mappings of the process: when half of those that the system allows are
    taken, the older half of the programs is dropped and, if that does not help, JAX's own caches are cleared.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._programs: OrderedDict[Hashable, Program] = OrderedDict()
        self._lock = threading.Lock()
        # Mappings that cannot be released here, those that there was room for at the last count, and programs since.
        self._foreign, self._room, self._since = 0, 0.0, 0

    def __contains__(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._programs

    def __getitem__(self, key: Hashable) -> Program:
        with self._lock:
            program = self._programs.setdefault(key, Program())
            self._programs.move_to_end(key)
            while len(self._programs) > self._most:
                self._programs.popitem(last=False)
        return program

    def make_room(self) -> None:
        """Ensure that another program can be mapped into memory.

        Counting takes as long as compiling a small program, and is left out while there is room for certain.
        """
        self._since += 1
        if self._since * _MOST_OF_ONE <= self._room:
            return
        crowded = self._is_crowded()
        while crowded and self._forget_older_half():
            gc.collect()
            crowded = self._is_crowded()
        if crowded:
            jax.clear_caches()
            gc.collect()
            self._foreign = mappings()

    def _is_crowded(self) -> bool:
        self._room, self._since = (self._foreign + most_mappings()) / 2 - mappings(), 0
        return self._room < 0

    def _forget_older_half(self) -> bool:
        """Drop the older half of the programs; return whether there were any."""
        with self._lock:
            ready = [key for key, program in self._programs.items() if program.is_ready]
            for key in ready[: -(-len(ready) // 2)]:
                del self._programs[key]
        return bool(ready)


def mappings() -> int:
    """How many memory mappings this process has; 0 if unknown."""
    try:
        with _OWN.open("rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0


def most_mappings() -> float:
    """How many it may have; infinite if the system sets no limit."""
    try:
        return int(_MOST.read_text())
    except (OSError, ValueError):
        return float("inf")


PROGRAMS = Programs()
