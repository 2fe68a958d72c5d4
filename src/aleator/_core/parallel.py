"""Work on all cores and devices by Python's threads, and Ctrl-C meanwhile: XLA releases the lock of the interpreter.

Parts of a computation are shared among devices, each as a whole, on one device in turn. A part's numbers therefore come
from the same program whichever device computes it, and sums over parts are formed in their order on one device.
"""

import contextlib
import contextvars
import itertools
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeAlias, TypeVar, final

import jax
from jax.core import Tracer

from aleator._core.border import whole
from aleator._core.errors import AleatorWarning

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""How many cores this process may use."""

VARIABLE = "ALEATOR_THREADS"
"""Environment variable: how many threads may work at once."""

# Runs functions that no signal in the main thread may interrupt.
_UNDISTURBED = ThreadPoolExecutor(1, thread_name_prefix="aleator, undisturbed")


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

    What no other thread has begun by then, the caller computes: with a single thread, everything.

    Not for functions that themselves call `beside`: with all threads waiting, none would end.
    """
    context, begun = contextvars.copy_context(), Future[_Result]()
    if working() > 1:
        with contextlib.suppress(RuntimeError):  # while the interpreter ends, no thread begins anything any more
            begun = _TEAM.others.submit(contextvars.copy_context().run, function, *arguments)

    def result() -> _Result:
        return context.run(function, *arguments) if begun.cancel() else begun.result()

    return result


@contextmanager
def dropped_on_failure() -> Iterator[None]:
    """Drop what waits for a core if the inside raises, so that Ctrl-C takes effect soon. Who needs it computes it."""
    global _TEAM
    try:
        yield
    except BaseException:
        team, _TEAM = _TEAM, _Team(_TEAM.size)
        team.others.shutdown(wait=False, cancel_futures=True)
        raise


def undisturbed(function: Callable[[], _Result]) -> _Result:
    """Call a function that no signal may interrupt: Ctrl-C ends the waiting, but the process lets the function finish.

    Signals arrive only in the main thread; in other threads the function is called directly.
    """
    if threading.current_thread() is not threading.main_thread():
        return function()
    return _UNDISTURBED.submit(function).result()


_BLAS_LOCK = threading.Lock()
_blas_users = 0
_blas_limits: Any = None


@contextmanager
def one_thread_of_blas() -> Iterator[None]:
    """Let NumPy multiply matrices by one thread meanwhile: several wait for one another, and for those that work beside
    them, longer than they multiply, and digits depend on their number.

    The limit is one of the process: the last who leaves it restores what the first has met.
    """
    global _blas_users, _blas_limits
    from threadpoolctl import threadpool_limits

    with _BLAS_LOCK:
        _blas_limits = _blas_limits if _blas_users else threadpool_limits(1, "blas")
        _blas_users += 1
    try:
        yield
    finally:
        with _BLAS_LOCK:
            _blas_users -= 1
            if not _blas_users:
                _blas_limits.restore_original_limits()


def in_order(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The results of `work` for each item, in order, computed by as many threads as allowed.

    Results are those of a plain loop, to the last digit; an exception of `work` is raised at its item's turn. Nothing
    waits for a core: the caller computes an item that no other thread has begun when its turn comes.
    """
    items = iter(items)
    while some := list(islice(items, working())):
        others = [beside(work, one) for one in some[1:]]
        yield work(some[0])
        yield from (result() for result in others)


Device: TypeAlias = Any
"""A device of JAX. (A type checker cannot follow `jax.Device`.)"""


def devices() -> tuple[Device, ...]:
    """The devices of this process that share the work, the one for all else first.

    One alone where JAX is told which to use (`jax.default_device`).
    """
    told = jax.config.jax_default_device  # type: ignore[attr-defined]
    if told is None:
        return tuple(jax.local_devices())
    return (jax.local_devices(backend=told)[0] if isinstance(told, str) else told,)


def here() -> Device:
    """The device of the present part, or the one for all that is no part."""
    return devices()[0]


def placed(tree: Any) -> Device | None:
    """The device on which a user has put an array of a tree, where all that follows from it stays; None if nowhere."""
    for leaf in jax.tree.leaves(tree):
        if isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.committed:
            return min(leaf.devices(), key=lambda one: one.id)
    return None


def over_devices(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The results of `in_order`, where the executables called for an item run on a device of its own, in turn."""
    all_of_them = devices()
    # Threads take the first one by themselves; what JAX is told in one of them, the others do not hear.
    if [*all_of_them] == jax.local_devices()[:1]:
        return in_order(work, items)

    def at_place(given: tuple[Device, _Item]) -> _Result:
        device, item = given
        with jax.default_device(device):
            return work(item)

    return in_order(at_place, zip(itertools.cycle(all_of_them), items))


# Ctrl-C, where its exception may be lost: in a solver's own code, or in a callback of the garbage collector.


@contextmanager
def noting(note: Callable[[], None]) -> Iterator[None]:
    """Call `note` at each SIGINT, and then the present handler unless it raises; in the main thread alone."""
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
def heeding(*, alone: bool = False) -> Iterator[Callable[[], None]]:
    """Gives a function that raises `KeyboardInterrupt` between two steps of some work if a Ctrl-C was lost in one.

    - `alone`: for work that a Ctrl-C only shortens: the handlers outside hear nothing of it.
    """
    heard: list[bool] = []

    def note() -> None:
        heard.append(True)
        if alone:
            raise KeyboardInterrupt

    def raise_if_heard() -> None:
        if heard:
            raise KeyboardInterrupt

    with noting(note):
        yield raise_if_heard
