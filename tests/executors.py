"""Executors for tests, and what they are given to do: in a module that other processes can import."""

import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp


class AsProcesses(Executor):
    """Threads that are taken for other processes, because nobody knows them: what they are given travels as pickles."""

    def __init__(self, count: int):
        self._threads = ThreadPoolExecutor(count)

    def submit(self, fn, /, *args, **kwargs) -> Future:
        return self._threads.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait, cancel_futures=cancel_futures)


class Inline(Executor):
    """Does work at once; `given` makes of its results so far, the last of them being asked for, what a future gives."""

    def __init__(self, given: Callable[[list], object]):
        self._given, self._results = given, []

    def submit(self, fn, /, *args, **kwargs) -> Future:
        self._results.append(fn(*args, **kwargs))
        future = Future()
        future.set_result(self._given(self._results))
        return future


class Lost(Executor):
    """Loses what it is given after some calls, as workers do that die, or that Ctrl-C ends."""

    def __init__(self, after: int, error: BaseException):
        self._left, self._error = after, error

    def submit(self, fn, /, *args, **kwargs) -> Future:
        future = Future()
        self._left -= 1
        if self._left < 0:
            future.set_exception(self._error)
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def scattered(model):
    """A sum, and a row of numbers."""
    return {"sum": model["off"] + model["more"], "row": jnp.stack([model["off"] ** 2, jnp.sin(model["more"])])}


def dies_once(mark: str, number: int) -> int:
    """Twice a number; the first process that is asked for three dies."""
    if number == 3 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def dies(number: int) -> int:
    """Never ends well."""
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def pressed(stage: str, after: int) -> Callable[[str, int, int], None]:
    """A callback that presses Ctrl-C in a stage."""

    def stop(task: str, done: int, total: int) -> None:
        if task == stage and done >= after:
            signal.raise_signal(signal.SIGINT)

    return stop
