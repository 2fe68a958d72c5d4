"""Work on all cores by Python's threads: XLA releases the interpreter's lock while it computes or compiles."""

import contextvars
import os
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar, final

from aleator._core.errors import AleatorWarning
from aleator._core.given import whole

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""How many cores this process may use."""

VARIABLE = "ALEATOR_THREADS"
"""Environment variable: how many threads may work at once."""

# Runs functions that no signal in the main thread may interrupt.
_UNDISTURBED = ThreadPoolExecutor(1, thread_name_prefix="aleator, undisturbed")
_DROPPED: contextvars.ContextVar[tuple[threading.Event, ...]] = contextvars.ContextVar("dropped", default=())


@final
class _Team:
    """The threads that work in parallel: `size` of them, including the one that waits for the others."""

    def __init__(self, size: int):
        self.size = size
        self.others = ThreadPoolExecutor(max(1, size - 1), thread_name_prefix="aleator")


def threads(count: int | None) -> None:
    """Limit the number of threads that compute in parallel from now on; `None` means the number of cores.

    Collocation points, batches of Monte Carlo and compilations are shared among them; results do not depend on their
    number, to the last digit. The environment variable `ALEATOR_THREADS` sets the number from the start. Work already
    begun is finished by the threads that began it. XLA has its own threads for products of large matrices; these follow
    the cores that the process may use (`taskset`, `os.sched_setaffinity`).

    Raises `ProblemError` unless `count` is a whole number of at least one.
    """
    global _TEAM
    _TEAM = _Team(CORES if count is None else whole("threads: count", count, least=1))


def working() -> int:
    """How many threads may work in parallel."""
    return _TEAM.size


def _wanted() -> int:
    """The number of threads set in the environment."""
    wanted = os.environ.get(VARIABLE, "").strip()
    if not wanted:
        return CORES
    if not wanted.isdecimal() or int(wanted) < 1:
        warnings.warn(
            f"{VARIABLE}: expected a whole number, one at least; received {wanted!r}. All {CORES} cores work.",
            AleatorWarning,
            stacklevel=2,
        )
        return CORES
    return int(wanted)


_TEAM = _Team(_wanted())


def beside(function: Callable[..., _Result], *arguments: object) -> Callable[[], _Result]:
    """Begin `function(*arguments)` on another core; the function returned waits for the result or raises its exception.

    With a single thread, it begins when the result is requested.

    Not for functions that themselves call `beside`: with all threads waiting, none would end.
    """
    if working() > 1:
        return _begun(function, *arguments).result
    context = contextvars.copy_context()
    return lambda: context.run(_unless_dropped, function, *arguments)


def _begun(function: Callable[..., _Result], *arguments: object) -> "Future[_Result]":
    return _TEAM.others.submit(contextvars.copy_context().run, _unless_dropped, function, *arguments)


def _unless_dropped(function: Callable[..., _Result], *arguments: object) -> _Result:
    if any(one.is_set() for one in _DROPPED.get()):
        raise CancelledError
    return function(*arguments)


@contextmanager
def dropped_on_failure() -> Iterator[None]:
    """Drop work begun inside that still waits for a core if the inside raises, so that Ctrl-C takes effect soon."""
    own = threading.Event()
    before = _DROPPED.set((*_DROPPED.get(), own))
    try:
        yield
    except BaseException:
        own.set()
        raise
    finally:
        _DROPPED.reset(before)


def undisturbed(function: Callable[[], _Result]) -> _Result:
    """Call a function that no signal may interrupt: Ctrl-C ends the waiting, but the process lets the function finish.

    Signals arrive only in the main thread; in other threads the function is called directly.
    """
    if threading.current_thread() is not threading.main_thread():
        return function()
    return _UNDISTURBED.submit(function).result()


def in_order(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The results of `work` for each item, in order, computed by as many threads as allowed.

    Results are those of a plain loop, to the last digit; an exception of `work` is raised at its item's turn. Nothing
    waits for a core: the caller computes an item that no other thread has begun when its turn comes.
    """
    items = iter(items)
    while some := list(islice(items, working())):
        others = [_begun(work, one) for one in some[1:]]
        yield work(some[0])
        for one, other in zip(some[1:], others, strict=True):
            yield work(one) if other.cancel() else other.result()
