"""Ctrl-C where its exception may be lost: in a solver's own code, or in a callback of the garbage collector."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def noting(note: Callable[[], None]) -> Iterator[None]:
    """Call `note` at each SIGINT, in addition to the present handler. Does nothing outside the main thread."""
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
    """Restore Python's handler of SIGINT after a library has installed its own.

    Does nothing outside the main thread. The effect is temporary: the library restores the handler that it found.
    """
    present = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is threading.main_thread() and callable(present):
        signal.signal(signal.SIGINT, present)


@contextmanager
def heeding() -> Iterator[Callable[[], None]]:
    """Gives a function that raises `KeyboardInterrupt` between two steps of some work if a Ctrl-C was lost in one."""
    heard: list[bool] = []

    def raise_if_heard() -> None:
        if heard:
            raise KeyboardInterrupt

    with noting(lambda: heard.append(True)):
        yield raise_if_heard


@contextmanager
def answering() -> Iterator[Callable[[], None]]:
    """Like `heeding`, for work that a Ctrl-C only shortens: whoever is outside hears nothing of it.

    Does nothing outside the main thread.
    """
    previous = signal.getsignal(signal.SIGINT)
    heard: list[bool] = []

    def raise_if_heard() -> None:
        if heard:
            raise KeyboardInterrupt

    def handle(number: int, frame: object) -> None:
        del number, frame
        heard.append(True)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield raise_if_heard
        return
    signal.signal(signal.SIGINT, handle)
    try:
        yield raise_if_heard
    finally:
        signal.signal(signal.SIGINT, previous)
