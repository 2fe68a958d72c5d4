"""SIGINT (Ctrl-C) and SIGTERM during a long run: finished results are kept, and the process says so."""

import logging
import math
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, final

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM") if hasattr(signal, name))

# How long work may take to end after an interrupt: a compilation, for instance, does not react.
_PATIENCE = 3.0

# Signals within this time count as one: some programs send theirs both to a process and to its group.
_ONE_WISH = 0.5

# Shows a terminal's cursor, which progress bars hide.
_SHOW_CURSOR = "\x1b[?25h"

# The state when a signal arrives: nothing to lose, work that it may end, or results not yet on the disk.
_IDLE, _WORKING, _WRITING = range(3)


@final
class Interruptions:
    """Watches for termination signals in a thread of its own, because Python handles them only between its steps.

    Inside `work()` the first signal raises `KeyboardInterrupt` in the main thread, so that finished results can be
    kept; if that has no effect, or at a second signal, the process ends immediately. Between `work()` and `rest()`,
    while results are written, a signal takes effect at the next `work()`, and only a second one ends the process.
    Before the first `work()` and after `rest()` it ends immediately. The exit code is 128 plus the number of the
    signal, and `said` gives the final message.

    Signals that were ignored when the process started remain ignored. Works in the main thread only.
    """

    def __init__(self, said: Callable[[], str]):
        self._said, self._place, self._raised = said, _IDLE, False
        self._before: dict[int, Any] = {}
        self._speaker = threading.Lock()
        self.received: int | None = None

    def __enter__(self) -> "Interruptions":
        self._ear, self._mouth = socket.socketpair()
        self._mouth.setblocking(False)
        self._descriptor = signal.set_wakeup_fd(self._mouth.fileno(), warn_on_full_buffer=False)
        self._unraisable, self._logging = sys.unraisablehook, logging.root.manager.disable
        sys.unraisablehook = self._hush
        self._watcher = threading.Thread(target=self._watch, name="interruptions", daemon=True)
        self._watcher.start()
        for number in STOPPING:
            before = signal.getsignal(number)
            if before is not signal.SIG_IGN:
                self._before[number] = before
                signal.signal(number, self._interrupt)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        signal.set_wakeup_fd(self._descriptor)
        sys.unraisablehook = self._unraisable
        logging.disable(self._logging)
        self._mouth.close()
        self._watcher.join()
        self._ear.close()

    @property
    def exit_code(self) -> int:
        """The exit code of an interrupted run."""
        return 128 + (self.received or signal.SIGINT)

    @contextmanager
    def work(self) -> Iterator[None]:
        """Work that a signal, even an earlier one, ends by `KeyboardInterrupt`."""
        self._place = _WORKING
        try:
            if self.received is not None and not self._raised:
                self._raised = True
                raise KeyboardInterrupt
            yield
        finally:
            self._place = _WRITING

    def rest(self) -> None:
        """Declare that all results are safe from here on."""
        self._place = _IDLE

    def conclude(self) -> None:
        """Write the final message from the main thread; does not return if the watching thread is about to do so."""
        self._speaker.acquire()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """The handler, which Python calls in the main thread between two steps."""
        self.received = self.received or number
        if self._place != _WORKING or self._raised:
            return
        # A solver's library may swallow the exception, so the code that runs one notes each SIGINT by its own handler.
        noting = signal.getsignal(signal.SIGINT)
        if number != signal.SIGINT and callable(noting) and noting != self._interrupt:
            noting(signal.SIGINT, frame)
        self._raised = True
        # Libraries would print the exceptions that end them.
        logging.disable()
        raise KeyboardInterrupt

    def _watch(self) -> None:
        """In the watching thread: end the process if the main thread may not react."""
        first, deadline = math.inf, math.inf
        while True:
            left = max(0.0, deadline - time.monotonic())
            heard = select.select([self._ear], [], [], None if math.isinf(left) else left)[0]
            numbers = self._ear.recv(64) if heard else b""
            if heard and not numbers:
                return
            stops, now = [number for number in numbers if number in self._before], time.monotonic()
            if not heard:
                deadline = math.inf
                if self._place == _WORKING:
                    self._end()
            elif stops and math.isinf(first):
                self.received, first, deadline = self.received or stops[0], now, now + _PATIENCE
                if self._place == _IDLE:
                    self._end()
            elif stops and now > first + _ONE_WISH:
                self._end()

    def _end(self) -> None:
        """End the process immediately, with a message. Nothing else runs: unfinished work stays unfinished."""
        if not self._speaker.acquire(blocking=False):
            return
        text = f"{self._said()}\n"
        if any(map(os.isatty, (1, 2))):
            text = f"{_SHOW_CURSOR}\n{text}"
        os.write(2, text.encode("utf-8", "replace"))
        os._exit(self.exit_code)

    def _hush(self, unraisable: Any) -> None:
        """Suppress messages on exceptions that Python cannot propagate, such as an interrupt inside a destructor."""
        if self.received is None:
            self._unraisable(unraisable)
