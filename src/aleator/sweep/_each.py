"""Several solves, or evidence of several designs: here one after the other, or at once by an executor."""

import pickle
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, Literal, TypeAlias, cast

from aleator._core.elsewhere import is_of_this_process, packed, sending
from aleator._core.errors import AleatorError, SimulationError
from aleator._core.journalled import AbstractEntry, NotKeptError, calling, entry_of
from aleator._core.warned import warned_of
from aleator.design import Problem, refuse_other_code
from aleator.solution import Solution
from aleator.solving import Call, follows_from, solve
from aleator.validation import validate, validated_from

Work: TypeAlias = Literal["solve", "validate"]
_GIVEN = {"solve": lambda **call: follows_from(Call(**call)), "validate": validated_from}


def each(
    work: Work, calls: Sequence[Mapping[str, Any]], where: Sequence[str], executor: Executor | None
) -> Iterator[tuple[int, Any]]:
    """The results of `solve` or `validate` for some arguments, each with its index, as soon as they are there.

    Warnings begin with the words in `where`. A refusal or a failure of a model is a result: the exception. What a
    journal has is not computed. Where the caller stops, what an executor has not begun is cancelled.

    Raises `ProblemError` for a model that cannot travel, and `SimulationError` if workers keep dying.
    """
    return _here(work, calls, where) if executor is None else _elsewhere(work, calls, where, executor)


def _here(work: Work, calls: Sequence[Mapping[str, Any]], where: Sequence[str]) -> Iterator[tuple[int, Any]]:
    absent = None
    for i, (call, place) in enumerate(zip(calls, where, strict=True)):
        try:
            with warned_of(place), calling(place):
                found = solve(**call, throw=False) if work == "solve" else validate(**call)
        except AleatorError as error:
            found = error
        except NotKeptError as error:  # the others may be there
            absent = error
            continue
        yield i, found
    if absent is not None:
        raise absent


def _elsewhere(
    work: Work, calls: Sequence[Mapping[str, Any]], where: Sequence[str], executor: Executor
) -> Iterator[tuple[int, Any]]:
    done = {"solve": _solved, "validate": _validated}[work]
    entries, absent = dict[int, AbstractEntry](), None
    for i, (call, place) in enumerate(zip(calls, where, strict=True)):
        try:
            entries[i] = _entry(work, call, place)
        except NotKeptError as error:
            absent = error
    packs = {i: packed(executor, done, calls[i]) for i, entry in entries.items() if entry.recalled is None}
    yield from ((i, entry.recalled) for i, entry in entries.items() if entry.recalled is not None)
    if absent is not None:
        raise absent
    with sending(executor) as sent:
        for i, pack in packs.items():
            sent.send(i, pack, where[i])
        for i, receive in sent.done():
            try:
                result = receive()
            except SimulationError as error:
                entries[i].failed(error)
                raise
            if isinstance(result, AleatorError):
                entries[i].failed(result)
            else:
                result = result if is_of_this_process(executor) else _of_here(result, calls[i])
                entries[i].keep(result)
            yield i, result


def _entry(work: Work, call: Mapping[str, Any], place: str) -> AbstractEntry:
    with calling(place):
        return entry_of(work, _GIVEN[work](**call))


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
