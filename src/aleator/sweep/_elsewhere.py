"""Solves and evidence by an executor: in other processes, or on other machines.

Problems and results travel as pickles of our own, so that every executor gives the same, and what cannot travel is told
before anything is sent.
"""

import pickle
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, cast

from aleator._core.errors import AleatorError, AleatorWarning, ProblemError, SimulationError
from aleator._core.given import refusal
from aleator._core.journalled import AbstractEntry, entry_of
from aleator._core.warned import warned_of
from aleator.design import Problem, current
from aleator.solution import Solution
from aleator.solving import Call, follows_from, solve
from aleator.validation import validate, validated_from

Work: TypeAlias = Literal["solve", "validate"]
# Python hears warnings in one thread of a process at a time; several threads of one would take them from each other.
_HEARD = threading.RLock()
_WORKS = {"solve": partial(solve, throw=False), "validate": validate}
_GIVEN = {"solve": lambda **call: follows_from(Call(**call)), "validate": validated_from}


def check_executor(who: str, executor: Any) -> None:
    """Refuse what is no executor of `concurrent.futures`."""
    if executor is not None and not isinstance(executor, Executor):
        expected = "an executor, such as al.workers(2), loky's, or Dask's client.get_executor()"
        raise refusal(f"{who}: executor", expected, executor)


def each_elsewhere(
    work: Work, executor: Executor, calls: Sequence[Mapping[str, Any]], where: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """The results of `solve` or `validate` for some arguments, each with its index, as soon as they are there.

    A refusal or a failure of a model is a result: the exception. What a journal has is not computed. Warnings begin
    with the words in `where`. Where the caller stops, what has not begun is cancelled.

    Raises `ProblemError` for models that cannot travel, and `SimulationError` if workers keep dying.
    """
    entries = [entry_of(work, _GIVEN[work](**one)) for one in calls]
    missing = [entry.recalled is None for entry in entries]
    packed = [_packed(work, one) if is_missing else None for is_missing, one in zip(missing, calls, strict=True)]
    yield from ((i, entry.recalled) for i, entry in enumerate(entries) if entry.recalled is not None)
    sent = {executor.submit(run, one): i for i, one in enumerate(packed) if one is not None}
    try:
        for future in as_completed(sent):
            i = sent[future]
            yield i, _received(future, entries[i], calls[i], where[i])
    finally:
        for future in sent:
            future.cancel()


def _packed(work: Work, call: Mapping[str, Any]) -> bytes:
    try:
        packed = pickle.dumps((work, dict(call)))
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(
            f"executor: the model cannot be sent to another process ({error}). Write its classes and functions in a "
            "module, not inside functions."
        ) from error
    if b"__main__" in packed:
        raise ProblemError(
            "executor: the model has classes or functions of the script itself (`__main__`), which other processes do "
            "not have. Move them into a module, a file of their own beside the script, and import them from there."
        )
    return packed


def run(packed: bytes) -> bytes:
    """Do some work in another process: the result or our own exception, and the warnings."""
    work, call = pickle.loads(packed)
    with _HEARD, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            result = _done(work, call)
        except AleatorError as error:
            result = error
    told = [(one.category, str(one.message)) for one in heard if issubclass(one.category, AleatorWarning)]
    return pickle.dumps((result, told))


def _done(work: Work, call: dict[str, Any]) -> Any:
    problem = call["problem"] if work == "solve" else call["solution"].problem
    if current(problem) is not problem:
        raise ProblemError(
            f"executor: a worker has other code of {type(problem.system).__name__} than this process. Start the "
            "workers anew, with the same files."
        )
    return _WORKS[work](**call)


def _received(future: "Future[bytes]", entry: AbstractEntry, call: Mapping[str, Any], where: str) -> Any:
    try:
        result, told = pickle.loads(future.result())
    except (OSError, RuntimeError, CancelledError) as error:
        entry.failed(error)
        raise SimulationError(
            f"{where}: its worker died or was lost ({type(error).__name__}: {error}). Finished results are kept within "
            "al.journal(folder); is there enough memory for as many workers?"
        ) from error
    with _HEARD, warned_of(where):
        for category, message in told:
            warnings.warn(message, category, stacklevel=2)
    if isinstance(result, AleatorError):
        entry.failed(result)
        return result
    result = _of_here(result, call)
    entry.keep(result)
    return result


def _of_here(result: Any, call: Mapping[str, Any]) -> Any:
    """A result of the objects of this process, where they are the same."""
    if isinstance(result, Solution):
        sent = cast(Problem, call["problem"])
        same = pickle.dumps(result.problem) == pickle.dumps(sent)
        return replace(result, problem=sent) if same else result
    return replace(result, solution=call["solution"])
