"""Solves and evidence by an executor, recalled and kept by the journal of this process."""

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import replace
from typing import Any, Literal, TypeAlias, cast

from aleator._core.elsewhere import packed, received, run
from aleator._core.errors import AleatorError, SimulationError
from aleator._core.journalled import entry_of
from aleator.design import Problem, refuse_other_code
from aleator.solution import Solution
from aleator.solving import Call, follows_from, solve
from aleator.validation import validate, validated_from

Work: TypeAlias = Literal["solve", "validate"]
_GIVEN = {"solve": lambda **call: follows_from(Call(**call)), "validate": validated_from}


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
    done = {"solve": _solved, "validate": _validated}[work]
    packs = [packed(done, one) if is_missing else None for is_missing, one in zip(missing, calls, strict=True)]
    yield from ((i, entry.recalled) for i, entry in enumerate(entries) if entry.recalled is not None)
    sent = {executor.submit(run, one): i for i, one in enumerate(packs) if one is not None}
    try:
        for future in as_completed(sent):
            i = sent[future]
            try:
                result = received(future, where[i])
            except SimulationError as error:
                entries[i].failed(error)
                raise
            if isinstance(result, AleatorError):
                entries[i].failed(result)
            else:
                result = _of_here(result, calls[i])
                entries[i].keep(result)
            yield i, result
    finally:
        for future in sent:
            future.cancel()


def solving_of(call: Mapping[str, Any]) -> tuple[Callable[[bytes], bytes], bytes]:
    """What an executor is given for one call of `solve`."""
    return run, packed(_solved, call)


def _solved(**call: Any) -> Solution:
    refuse_other_code(call["problem"])
    return solve(**call, throw=False)


def _validated(**call: Any) -> Any:
    refuse_other_code(call["solution"].problem)
    return validate(**call)


def _of_here(result: Any, call: Mapping[str, Any]) -> Any:
    """A result of the objects of this process, where they are the same."""
    if isinstance(result, Solution):
        sent = cast(Problem, call["problem"])
        same = pickle.dumps(result.problem) == pickle.dumps(sent)
        return replace(result, problem=sent) if same else result
    return replace(result, solution=call["solution"])
