"""Work on all cores: Python's threads, for Python runs on while XLA computes or compiles."""

import contextvars
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""How many cores this process may use."""

# What the main thread must not be torn from by a signal.
_UNDISTURBED = ThreadPoolExecutor(1, thread_name_prefix="aleator, undisturbed")
# Whoever waits for these works as well.
_OTHERS = ThreadPoolExecutor(max(1, CORES - 1), thread_name_prefix="aleator")
_DROPPED: contextvars.ContextVar[tuple[threading.Event, ...]] = contextvars.ContextVar("dropped", default=())


def beside(function: Callable[..., _Result], *arguments: object) -> Callable[[], _Result]:
    """Begin `function(*arguments)` on another core. What is returned waits for the result, or raises what it raised.

    Not for functions that begin others in this way: with all cores waiting, none of them would end.
    """
    return _OTHERS.submit(contextvars.copy_context().run, _unless_dropped, function, *arguments).result


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
    """What `work` gives for each item, in their order, of which as many are worked on at once as there are cores.

    Results are those of a plain loop, to the last digit. What `work` raises is raised in its turn.
    """
    items = iter(items)
    while some := list(islice(items, CORES)):
        others = [beside(work, one) for one in some[1:]]
        yield work(some[0])
        yield from (other() for other in others)
