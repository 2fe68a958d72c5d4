"""Ctrl-C where the exception itself may be lost: in a solver's own code, or in a callback of the garbage collector."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def noting(note: Callable[[], None]) -> Iterator[None]:
    """Call `note` at each SIGINT as well as what is called otherwise. Does nothing outside the main thread."""
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield
        return

    def handle(number: int, frame: object) -> None:
        note()
        previous(number, frame)  # type: ignore[arg-type]

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def take_back() -> None:
    """Let Python hear SIGINT again, where a library has put a handler of its own in front of Python's.

    Does nothing outside the main thread, and nothing that lasts: the library puts back what it found.
    """
    present = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is threading.main_thread() and callable(present):
        signal.signal(signal.SIGINT, present)


@contextmanager
def heeding() -> Iterator[Callable[[], None]]:
    """Gives what raises `KeyboardInterrupt`, between two steps of some work, for a Ctrl-C that was lost in one."""
    heard: list[bool] = []

    def raise_if_heard() -> None:
        if heard:
            raise KeyboardInterrupt

    with noting(lambda: heard.append(True)):
        yield raise_if_heard
