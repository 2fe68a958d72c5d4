"""Work by an executor of `concurrent.futures`: in other processes, or on other machines.

Arguments and results travel as pickles of our own, so that every executor gives the same, and what cannot travel is
told before anything is sent.
"""

import pickle
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from typing import Any, TypeAlias

from aleator._core.errors import AleatorError, AleatorWarning, ProblemError, SimulationError
from aleator._core.given import refusal
from aleator._core.warned import warned_of

Work: TypeAlias = Callable[..., Any]
"""A function of a module of ours, so that a pickle names it."""

# Python hears warnings in one thread of a process at a time; several threads of one would take them from each other.
_HEARD = threading.RLock()


def check_executor(who: str, executor: Any) -> None:
    """Refuse what is no executor of `concurrent.futures`."""
    if executor is not None and not isinstance(executor, Executor):
        expected = "an executor, such as al.workers(2), loky's, or Dask's client.get_executor()"
        raise refusal(f"{who}: executor", expected, executor)


def each_done(
    executor: Executor, work: Work, calls: Sequence[Mapping[str, Any]], where: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """The results of `work` for some arguments, each with its index, as soon as they are there.

    Warnings begin with the words in `where`. Where the caller stops, what has not begun is cancelled. Raises what the
    work raises, `ProblemError` for arguments that cannot travel, and `SimulationError` if workers keep dying.
    """
    packs = [packed(work, one) for one in calls]
    sent = {executor.submit(run, one): i for i, one in enumerate(packs)}
    try:
        for future in as_completed(sent):
            i = sent[future]
            result = received(future, where[i])
            if isinstance(result, AleatorError):
                raise result
            yield i, result
    finally:
        for future in sent:
            future.cancel()


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
    """Do some work in another process: the result or our own exception, and the warnings."""
    work, call = pickle.loads(pack)
    with _HEARD, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            result = work(**call)
        except AleatorError as error:
            result = error
    told = [(one.category, str(one.message)) for one in heard if issubclass(one.category, AleatorWarning)]
    return pickle.dumps((result, told))


def received(future: "Future[bytes]", where: str) -> Any:
    """The result of `run`, or our own exception as a result, with its warnings told here.

    Raises `SimulationError` if the worker was lost.
    """
    try:
        result, told = pickle.loads(future.result())
    except (OSError, RuntimeError, CancelledError) as error:
        raise SimulationError(
            f"{where}: its worker died or was lost ({type(error).__name__}: {error}). Finished results are kept within "
            "al.journal(folder); is there enough memory for as many workers?"
        ) from error
    with _HEARD, warned_of(where):
        for category, message in told:
            warnings.warn(message, category, stacklevel=2)
    return result
