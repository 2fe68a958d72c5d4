"""Work by an executor of `concurrent.futures`: in other processes, or on other machines.

Arguments and results travel as pickles of our own, so that every executor gives the same, and what cannot travel is
told before anything is sent.
"""

import hashlib
import pickle
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from contextlib import contextmanager
from typing import Any, TypeAlias, TypeVar

from aleator._core.errors import AleatorError, AleatorWarning, ProblemError, SimulationError
from aleator._core.given import refusal, shown
from aleator._core.warned import warned_of

Work: TypeAlias = Callable[..., Any]
"""A function of a module of ours, so that a pickle names it."""

Sent: TypeAlias = dict["Future[bytes]", int]
"""The futures of work that was sent, each with its index."""

_Item = TypeVar("_Item")

# Calls of an executor at most for many items: enough to share them evenly, few enough that sending costs nothing.
_CALLS = 32

# Python hears warnings in one thread of a process at a time; several threads of one would take them from each other.
_HEARD = threading.RLock()


def check_executor(who: str, executor: Any) -> None:
    """Refuse what is no executor of `concurrent.futures`, and forked processes: the threads of JAX survive no fork."""
    if executor is None:
        return
    if not isinstance(executor, Executor):
        expected = "an executor, such as al.workers(2), loky's, or Dask's client.get_executor()"
        raise refusal(f"{who}: executor", expected, executor)
    context = getattr(executor, "_mp_context", None)  # of a ProcessPoolExecutor, also where none was given
    if context is not None and context.get_start_method() == "fork":
        raise ProblemError(
            f"{who}: executor: expected one whose processes are spawned, because forked ones can hang for ever with "
            "JAX; received processes that are forked. Write al.workers(2), or "
            'ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")).'
        )


def each_done(
    executor: Executor, work: Work, calls: Sequence[Mapping[str, Any]], where: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """The results of `work` for some arguments, each with its index, as soon as they are there.

    Warnings begin with the words in `where`. Where the caller stops, what has not begun is cancelled. Raises what the
    work raises, `ProblemError` for arguments that cannot travel, and `SimulationError` if workers keep dying.
    """
    packs = {i: packed(work, one) for i, one in enumerate(calls)}
    with sending(executor, packs, where) as sent:
        for future in as_completed(sent):
            i = sent[future]
            result = received(future, packs[i], where[i])
            if isinstance(result, AleatorError):
                raise result
            yield i, result


def each_of(
    executor: Executor, work: Work, items: Sequence[_Item], given: Mapping[str, Any], where: str
) -> Iterator[tuple[_Item, Any]]:
    """Each item with what is found for it, in order; `work(items=some, **given)` returns a list for some of them.

    Neighbours are sent together, the same ones to every executor. Raises the errors of `each_done`.
    """
    size = max(-(-len(items) // _CALLS), 1)
    shares = [items[first : first + size] for first in range(0, len(items), size)]
    calls = [{**given, "items": one} for one in shares]
    waiting: dict[int, Sequence[Any]] = {}
    following = 0
    for i, found in each_done(executor, work, calls, [where] * len(calls)):
        waiting[i] = found
        while following in waiting:
            yield from zip(shares[following], waiting.pop(following), strict=True)
            following += 1


@contextmanager
def sending(
    executor: Executor, packs: Mapping[int, bytes], where: Sequence[str]
) -> "Iterator[dict[Future[bytes], int]]":
    """Send packs of work by their indices, which the futures have within the block; after it, the rest is cancelled.

    Raises `SimulationError` if the executor does not take them.
    """
    sent: Sent = {}
    try:
        for i, pack in packs.items():
            future = _submitted(executor, pack, where[i])
            if future in sent:
                raise _lost(where[i], "the executor gave the same future for two pieces of work")
            sent[future] = i
        yield sent
    finally:
        for future in sent:
            future.cancel()


def _submitted(executor: Executor, pack: bytes, where: str) -> "Future[bytes]":
    try:
        future = executor.submit(run, pack)
    except Exception as error:  # every executor has its own
        raise _lost(where, f"the executor did not take the work ({type(error).__name__}: {error})") from error
    if not isinstance(future, Future):
        raise _lost(where, f"expected a future of concurrent.futures from the executor; received {shown(future)}")
    return future


def _lost(where: str, why: str) -> SimulationError:
    return SimulationError(f"{where}: {why}. Finished results are kept within al.journal(folder), for the next run.")


def packed(work: Work, call: Mapping[str, Any]) -> bytes:
    """Some work with its arguments by name. Raises `ProblemError` for what other processes could not read."""
    try:
        pack = pickle.dumps((work, dict(call)))
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(
            f"executor: the model cannot be sent to another process ({error}). Write its classes and functions in a "
            "module, not inside functions."
        ) from error
    if b"__main__" in pack:
        raise ProblemError(
            "executor: the model has classes or functions of the script itself (`__main__`), which other processes do "
            "not have. Move them into a module, a file of their own beside the script, and import them from there."
        )
    return pack


def run(pack: bytes) -> bytes:
    """Do some work in another process: a digest of it, the result or our own exception, and the warnings."""
    work, call = pickle.loads(pack)
    with _HEARD, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            result = work(**call)
        except AleatorError as error:
            result = error
    told = [(one.category, str(one.message)) for one in heard if issubclass(one.category, AleatorWarning)]
    return pickle.dumps((_digest(pack), result, told))


def _digest(pack: bytes) -> bytes:
    """Tells one piece of work from another, so that no result is believed that an executor gives for another one."""
    return hashlib.sha256(pack).digest()


def received(future: "Future[bytes]", pack: bytes, where: str) -> Any:
    """The result of `run` for a pack, or our own exception as a result, with its warnings told here.

    Raises `SimulationError` if the worker was lost, or gave what is no result of this pack.
    """
    try:
        given = future.result()
    except (OSError, RuntimeError, CancelledError) as error:
        raise SimulationError(
            f"{where}: its worker died or was lost ({type(error).__name__}: {error}). Finished results are kept within "
            "al.journal(folder); is there enough memory for as many workers?"
        ) from error
    try:
        digest, result, told = pickle.loads(given)
    except Exception as error:  # of whatever kind nonsense raises
        raise _lost(where, f"expected what a worker has found; received {shown(given)} from the executor") from error
    if digest != _digest(pack):
        raise _lost(where, "the executor gave the result of other work, which is not used")
    with _HEARD, warned_of(where):
        for category, message in told:
            warnings.warn(message, category, stacklevel=2)
    return result
