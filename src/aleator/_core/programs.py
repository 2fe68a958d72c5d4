"""Programs: traced once, compiled by the first thread that needs them, and kept while there is room."""

import gc
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from typing import Any, final

import jax

from aleator._core.beside import undisturbed
from aleator._core.mappings import mappings, most_mappings

Executable = Callable[..., Any]

# Enough for a session's problems; beyond, the least recently used one is dropped, with the classes it holds.
_KEPT = 256

# Memory mappings that one program takes at most, with what JAX compiles beside it.
_MOST_OF_ONE = 1000


@final
class Program:
    """A program that one thread traces, and the first thread that needs it compiles while others wait.

    Nothing waits for a core: if another thread was to compile a program and has not begun, its caller compiles it. A
    program that fails is forgotten; if tracing fails, it does so for all threads that wait.
    """

    def __init__(self, key: Hashable):
        self.key = key
        self._traced: Future[None] = Future()
        # The traced function is released once it is compiled.
        self._finish: Callable[[], Executable] | None = None
        self._executable: Executable | None = None
        self._lock = threading.Lock()

    @property
    def is_ready(self) -> bool:
        """Whether it has been compiled."""
        return self._executable is not None

    def trace(self, build: Callable[[], Callable[[], Executable]]) -> None:
        """Trace it, in the one thread responsible: `build` returns the function that compiles it."""
        try:
            self._finish = build()
        except BaseException as error:
            PROGRAMS.forget(self)
            self._traced.set_exception(error)
            raise
        self._traced.set_result(None)

    def was_interrupted(self) -> bool:
        """Whether Ctrl-C ended the tracing. Waits for its end."""
        return isinstance(self._traced.exception(), KeyboardInterrupt)

    def __call__(self) -> Executable:
        """The executable, compiled now if it has not been."""
        # After Ctrl-C, XLA would go on compiling, and a process that ends meanwhile is aborted.
        return self._executable or undisturbed(self._compiled)

    def _compiled(self) -> Executable:
        self._traced.result()
        with self._lock:
            if self._executable is None:
                assert self._finish is not None
                PROGRAMS.make_room()
                try:
                    self._executable = self._finish()
                except BaseException:
                    PROGRAMS.forget(self)
                    raise
                self._finish = None
            return self._executable


@final
class Programs:
    """Programs by their keys; the least recently used are dropped if there are too many.

    `most` bounds their number. So do the memory mappings of the process: when half of those that the system allows are
    taken, the older half of the programs is dropped and, if that does not help, JAX's own caches are cleared.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._kept: OrderedDict[Hashable, Program] = OrderedDict()
        self._lock = threading.Lock()
        # Mappings that cannot be released here, those that there was room for at the last count, and programs since.
        self._foreign, self._room, self._since = 0, 0.0, 0

    def __contains__(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._kept

    def found(self, key: Hashable) -> tuple[Program, bool]:
        """The program of a key, and whether it is a new one, which the caller must trace."""
        with self._lock:
            known = self._kept.get(key)
            program = self._kept.setdefault(key, known or Program(key))
            self._kept.move_to_end(key)
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return program, known is None

    def forget(self, program: Program) -> None:
        """Drop a program, so that it is traced again when needed."""
        with self._lock:
            if self._kept.get(program.key) is program:
                del self._kept[program.key]

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
            ready = [key for key, program in self._kept.items() if program.is_ready]
            for key in ready[: -(-len(ready) // 2)]:
                del self._kept[key]
        return bool(ready)


PROGRAMS = Programs()
