"""SIGINT (Ctrl-C) and SIGTERM during a long run: nothing that was finished is lost, and the process says so."""

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

# How long work may take to come to an end once it was interrupted: a compilation, for instance, notices nothing.
_PATIENCE = 3.0

# Signals that come together are one wish: some programs send theirs to a process and to its group.
_ONE_WISH = 0.5

# A terminal's cursor, which bars of progress hide.
_SHOW_CURSOR = "\x1b[?25h"

# What a signal would find: nothing to lose, work that it may end, or results that are not yet on the disk.
_IDLE, _WORKING, _WRITING = range(3)


@final
class Interruptions:
    """Watches for signals that ask a run to end, in a thread of its own: Python looks for them only between its steps.

    Inside `work()` the first signal raises `KeyboardInterrupt` in the main thread, so that what was finished can be
    kept; if that is not heard, and at a second signal, the process ends at once. From there to `rest()`, while results
    are written, it waits for the next `work()`, and only a second signal ends the process. Before the first work and
    after `rest()` it ends at once. The exit code is 128 plus the number of the signal, and `said` gives the last words.

    Signals that were ignored when the process was started stay so. Works in the main thread only.
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
        """The exit code of a run that was interrupted."""
        return 128 + (self.received or signal.SIGINT)

    @contextmanager
    def work(self) -> Iterator[None]:
        """Work that a signal ends by `KeyboardInterrupt`, also one that has come before."""
        self._place = _WORKING
        try:
            if self.received is not None and not self._raised:
                self._raised = True
                raise KeyboardInterrupt
            yield
        finally:
            self._place = _WRITING

    def rest(self) -> None:
        """From here on there is nothing to lose."""
        self._place = _IDLE

    def conclude(self) -> None:
        """The main thread says the last words, unless the watching thread is about to: then it does not return."""
        self._speaker.acquire()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """In the main thread, as soon as Python comes to it."""
        self.received = self.received or number
        if self._place != _WORKING or self._raised:
            return
        # A solver's library may swallow the exception, so whoever runs one notes each SIGINT by a handler of its own.
        noting = signal.getsignal(signal.SIGINT)
        if number != signal.SIGINT and callable(noting) and noting != self._interrupt:
            noting(signal.SIGINT, frame)
        self._raised = True
        # Libraries would show on their way what ends them.
        logging.disable()
        raise KeyboardInterrupt

    def _watch(self) -> None:
        """In the watching thread: end the process where the main thread may not come to it."""
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
        """End the process here and now, with a word. Nothing else runs: whatever is half done stays half done."""
        if not self._speaker.acquire(blocking=False):
            return
        text = f"{self._said()}\n"
        if any(map(os.isatty, (1, 2))):
            text = f"{_SHOW_CURSOR}\n{text}"
        os.write(2, text.encode("utf-8", "replace"))
        os._exit(self.exit_code)

    def _hush(self, unraisable: Any) -> None:
        """Exceptions that Python cannot pass on, such as an interrupt in the place of a destructor, are not shown."""
        if self.received is None:
            self._unraisable(unraisable)
