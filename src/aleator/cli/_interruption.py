"""SIGINT (Ctrl-C) and SIGTERM during a long run: finished results are kept, and the process says so."""

import logging
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import final

_STOPPING = signal.SIGINT, signal.SIGTERM

# How long work may take to end after an interrupt: a compilation, for instance, does not react.
_PATIENCE = 3.0

# Signals within this time count as one: some programs send theirs both to a process and to its group.
_ONE_WISH = 0.5


@final
class Interruptions:
    """Watches for termination signals in a thread of its own, because Python handles them only between its steps.

    The first signal raises `KeyboardInterrupt` in the main thread, so that finished results can be written; where these
    are written already (`shielded`), after that. If it has no effect, or at a second signal, `end` is called with the
    exit code, 128 plus the number of the signal, and ends the process at once.

    Signals that were ignored when the process started remain ignored. Works in the main thread only.
    """

    def __init__(self, end: Callable[[int], object]):
        self._end, self._is_shielded, self._is_raised = end, False, False
        self._speaker = threading.RLock()
        self.received: int | None = None

    def __enter__(self) -> "Interruptions":
        self._ear, self._mouth = socket.socketpair()
        self._mouth.setblocking(False)
        self._descriptor = signal.set_wakeup_fd(self._mouth.fileno(), warn_on_full_buffer=False)
        self._unraisable, self._logging = sys.unraisablehook, logging.root.manager.disable
        handlers = {number: signal.getsignal(number) for number in _STOPPING}
        self._before = {number: one for number, one in handlers.items() if one is not signal.SIG_IGN}
        self._watcher = threading.Thread(target=self._watch, name="interruptions", daemon=True)
        self._watcher.start()
        for number in self._before:
            signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *ended: object) -> None:
        self.conclude()
        for number, before in self._before.items():
            signal.signal(number, before)
        signal.set_wakeup_fd(self._descriptor)
        sys.unraisablehook = self._unraisable
        logging.disable(self._logging)
        self._mouth.close()
        self._watcher.join()
        self._ear.close()

    @contextmanager
    def shielded(self) -> Iterator[None]:
        """Work that the first signal ends only when it is done."""
        self._is_shielded = True
        try:
            yield
        finally:
            self._is_shielded = False
        if self.received is not None and not self._is_raised:
            self._is_raised = True
            raise KeyboardInterrupt

    def conclude(self) -> int:
        """Leave the last word to the main thread, unless another thread is about to say it; returns the exit code."""
        self._speaker.acquire()
        return 128 + (self.received or signal.SIGINT)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """The handler, which Python calls in the main thread between two steps."""
        self.received = self.received or number
        if self._is_shielded or self._is_raised:
            return
        # A solver's library may swallow the exception, so the code that runs one notes each SIGINT by its own handler.
        noting = signal.getsignal(signal.SIGINT)
        if number != signal.SIGINT and callable(noting) and noting != self._interrupt:
            noting(signal.SIGINT, frame)
        self._is_raised = True
        # Libraries, and Python where it cannot propagate it, would print the exception.
        logging.disable()
        sys.unraisablehook = lambda _: None
        raise KeyboardInterrupt

    def _watch(self) -> None:
        """In the watching thread: end the process if the main thread may not react."""
        first = 0.0
        while numbers := self._ear.recv(64):
            stops, now = [number for number in numbers if number in self._before], time.monotonic()
            if stops and not first:
                self.received, first = self.received or stops[0], now
                threading.Thread(target=self._wait, daemon=True).start()
            elif stops and now > first + _ONE_WISH:
                self._end_at_once()

    def _wait(self) -> None:
        """In a third thread: end the process if the main thread has come neither to its end nor to its results."""
        time.sleep(_PATIENCE)
        if not self._is_shielded:
            self._end_at_once()

    def _end_at_once(self) -> None:
        if self._speaker.acquire(blocking=False):
            self._end(self.conclude())
