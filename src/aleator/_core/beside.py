"""Work on all cores: Python's threads, for Python runs on while XLA computes or compiles."""

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

# What the main thread must not be torn from by a signal.
_UNDISTURBED = ThreadPoolExecutor(1, thread_name_prefix="aleator, undisturbed")
_DROPPED: contextvars.ContextVar[tuple[threading.Event, ...]] = contextvars.ContextVar("dropped", default=())


@final
class _Team:
    """The threads that work at once: `size` of them, of which whoever waits for the others is one."""

    def __init__(self, size: int):
        self.size = size
        self.others = ThreadPoolExecutor(max(1, size - 1), thread_name_prefix="aleator")


def threads(count: int | None) -> None:
    """Let at most `count` threads compute at once from now on; with `None` as many as there are cores.

    Collocation points, batches of Monte Carlo and compilations are shared among them; results do not depend on their
    number, to the last digit. The environment variable `ALEATOR_THREADS` says the same from the beginning. What is
    begun already is finished by the threads it was begun with. XLA has threads of its own for products of large
    matrices; these follow the cores that the process may use (`taskset`, `os.sched_setaffinity`).

    Raises `ProblemError` unless `count` is a whole number, one at least.
    """
    global _TEAM
    _TEAM = _Team(CORES if count is None else whole("threads: count", count, least=1))


def working() -> int:
    """How many threads may work at once."""
    return _TEAM.size


def _wanted() -> int:
    """The number of threads that the environment asks for."""
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
    """Begin `function(*arguments)` on another core. What is returned waits for the result, or raises what it raised.

    Where one thread is to do it all, it begins when the result is asked for.

    Not for functions that begin others in this way: with all cores waiting, none of them would end.
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
    """What is begun inside, and waits for a core still, is dropped where the inside raises: Ctrl-C is to end soon."""
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
    """The result of a function that no signal tears apart: Ctrl-C ends the waiting, and the process waits for the rest.

    Signals arrive in the main thread alone; in others the function is just called.
    """
    if threading.current_thread() is not threading.main_thread():
        return function()
    return _UNDISTURBED.submit(function).result()


def in_order(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """What `work` gives for each item, in their order, of which as many are worked on at once as threads may be.

    Results are those of a plain loop, to the last digit. What `work` raises is raised in its turn. Nobody waits for a
    core: what no other thread has begun when its turn comes is worked on by the caller.
    """
    items = iter(items)
    while some := list(islice(items, working())):
        others = [_begun(work, one) for one in some[1:]]
        yield work(some[0])
        for one, other in zip(some[1:], others, strict=True):
            yield work(one) if other.cancel() else other.result()
