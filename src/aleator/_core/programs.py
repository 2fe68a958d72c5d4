"""Programs: what is traced once, compiled by whoever needs it first, and kept while there is room."""

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

# Enough for a session's problems; beyond, the one unused for longest is dropped, with the classes it holds.
_KEPT = 256


@final
class Program:
    """What one thread traces, and the first that needs it compiles, while others wait.

    Nobody waits for a core here: a program that is begun on another one, and not there yet, is compiled by its caller.
    What fails is forgotten; tracing that fails does so for all that wait.
    """

    def __init__(self, key: Hashable):
        self.key = key
        self._traced: Future[None] = Future()
        # What was traced is held no longer than until it is compiled.
        self._finish: Callable[[], Executable] | None = None
        self._executable: Executable | None = None
        self._lock = threading.Lock()

    @property
    def is_ready(self) -> bool:
        """Whether it has been compiled."""
        return self._executable is not None

    def trace(self, build: Callable[[], Callable[[], Executable]]) -> None:
        """Trace it, by the one thread that is to: `build` gives what compiles it."""
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
        # Ctrl-C would leave XLA compiling by itself, and a process that ends meanwhile is aborted.
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
    """Programs by their keys, of which those unused for longest are dropped where there are too many.

    `most` bounds their number. The memory mappings of the process bound it too: where half of what the system allows
    is taken, the older half of the programs goes, and what JAX keeps by itself if that does not help.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._kept: OrderedDict[Hashable, Program] = OrderedDict()
        self._lock = threading.Lock()
        # Mappings that are not ours to give back.
        self._foreign = 0

    def __contains__(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._kept

    def found(self, key: Hashable) -> tuple[Program, bool]:
        """The program of a key, and whether it is a new one, which its finder is to trace."""
        with self._lock:
            known = self._kept.get(key)
            program = self._kept.setdefault(key, known or Program(key))
            self._kept.move_to_end(key)
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return program, known is None

    def forget(self, program: Program) -> None:
        """Drop a program, so that it is traced anew when it is needed again."""
        with self._lock:
            if self._kept.get(program.key) is program:
                del self._kept[program.key]

    def make_room(self) -> None:
        """See to it that another program can be mapped into memory."""
        while self._is_crowded() and self._forget_older_half():
            gc.collect()
        if self._is_crowded():
            jax.clear_caches()
            gc.collect()
            self._foreign = mappings()

    def _is_crowded(self) -> bool:
        return mappings() > (self._foreign + most_mappings()) / 2

    def _forget_older_half(self) -> bool:
        """Whether there was any program to forget."""
        with self._lock:
            ready = [key for key, program in self._kept.items() if program.is_ready]
            for key in ready[: -(-len(ready) // 2)]:
                del self._kept[key]
        return bool(ready)


PROGRAMS = Programs()
