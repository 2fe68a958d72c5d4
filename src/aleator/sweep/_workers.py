"""`workers`: processes on this machine, one a core, that outlive the death of any of them."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.queues import Queue
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar, final

from typing_extensions import override

from aleator._core.border import whole
from aleator._core.executors import end_with_parent
from aleator._core.parallel import CORES, threads

_Result = TypeVar("_Result")

# How often work is begun again after its worker, or another one, has died.
_AGAIN = 3
# Environment variables of the libraries that NumPy and SciPy may use.
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_MASKS = hasattr(signal, "pthread_sigmask")  # not on Windows


def workers(count: int | None = None) -> Executor:
    """An executor of `count` processes on this machine, by default one for each core, for `executor=` of sweeps.

        with al.workers(2) as executor:
            front = al.pareto(problem, "mass", values, executor=executor)

    Each has a core and one thread of its own, takes compiled programs from the same folder (`al.compilation_cache`),
    and lives until the end of the block. If one dies (the machine's memory may be short), the others are replaced too,
    and what they did is begun again, up to three times. A script that uses them begins its work under
    `if __name__ == "__main__":`, since each process reads it once; models stand in modules of their own.
    """
    return Workers(CORES if count is None else whole("workers: count", count))


@final
class Workers(Executor):
    """A pool of processes that is replaced when it breaks."""

    def __init__(self, count: int):
        self._count, self._pool, self._closed = count, None, False
        self._lock = threading.RLock()

    @override
    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> "Future[_Result]":
        if self._closed:
            raise RuntimeError("the workers have been shut down: expected a call within their `with` block.")
        future: Future[_Result] = Future()
        self._send(future, lambda pool: pool.submit(_worked, fn, *args, **kwargs), 0)
        return future

    def _send(self, future: "Future[Any]", submit: Callable[[ProcessPoolExecutor], "Future[Any]"], tries: int) -> None:
        with self._lock:
            pool = self._pool = self._pool or self._begun()
            with _beginning():  # of processes, which `submit` may begin
                try:
                    inner = submit(pool)
                except BrokenProcessPool:
                    self._pool = None
                    pool = self._pool = self._begun()
                    inner = submit(pool)

        def finish(done: "Future[Any]") -> None:
            if done.cancelled() or future.cancelled():
                future.cancel()
            elif isinstance(done.exception(), BrokenProcessPool) and tries < _AGAIN and not self._closed:
                with self._lock:
                    self._pool = None if self._pool is pool else self._pool
                self._send(future, submit, tries + 1)
            elif error := done.exception():
                future.set_exception(error)
            else:
                future.set_result(done.result())

        # What has not begun can be cancelled from outside.
        future.add_done_callback(lambda one: inner.cancel() if one.cancelled() else None)
        inner.add_done_callback(finish)

    def _begun(self) -> ProcessPoolExecutor:
        # Never forked: JAX has threads, whose locks a copy of the process would keep for ever.
        context = get_context("spawn")
        cores = context.Queue()
        for core in range(self._count):
            cores.put(core)
        return ProcessPoolExecutor(self._count, context, _settle, (cores,))

    @override
    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._lock:
            self._closed, pool = True, self._pool
        if pool is not None:
            pool.shutdown(wait, cancel_futures=cancel_futures)


@contextmanager
def _beginning() -> Iterator[None]:
    """Let processes begin within a block: Ctrl-C waits until they have settled, and linear algebra has one thread there
    unless the user says otherwise, because a second one on the same core would wait by turning in circles.
    """
    fresh = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(fresh, "1"))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if _MASKS else set()
    try:
        yield
    finally:
        if _MASKS:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for name in fresh:
            os.environ.pop(name, None)


# Whether this process, a worker, is doing something.
_busy = threading.Event()


def _settle(cores: "Queue[int]") -> None:
    """Begin a worker: one core, which the threads of libraries keep to as well, and one thread of ours."""
    end_with_parent()  # first, while the thread that watches inherits that Ctrl-C waits
    signal.signal(signal.SIGINT, _interrupt)
    if _MASKS:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    core, tasks = cores.get(), Path("/proc/self/task")  # its threads; later ones keep to the core of these
    if hasattr(os, "sched_setaffinity"):
        mine = sorted(os.sched_getaffinity(0))
        for thread in [int(one.name) for one in tasks.iterdir()] if tasks.is_dir() else [0]:
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setaffinity(thread, {mine[core % len(mine)]})
    threads(1)


def _worked(fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> _Result:
    """What a worker does."""
    _busy.set()
    try:
        return fn(*args, **kwargs)
    finally:
        _busy.clear()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """End work at Ctrl-C as Python does, and a worker without any without a word: a terminal tells it to all."""
    if _busy.is_set():
        signal.default_int_handler(number, frame)
    os._exit(128 + number)
