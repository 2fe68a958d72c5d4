"""Solves and evidence by an executor, recalled and kept by the journal of this process."""

import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, Literal, NamedTuple, TypeAlias, cast

from aleator._core.elsewhere import Sent, is_of_this_process, packed, run, sending
from aleator._core.errors import AleatorError, SimulationError
from aleator._core.journalled import AbstractEntry, entry_of
from aleator.design import Problem, refuse_other_code
from aleator.solution import Solution
from aleator.solving import Call, follows_from, solve
from aleator.sweep._workers import Workers
from aleator.validation import validate, validated_from

Work: TypeAlias = Literal["solve", "validate"]
_GIVEN = {"solve": lambda **call: follows_from(Call(**call)), "validate": validated_from}


def each_elsewhere(
    work: Work, executor: Executor, calls: Sequence[Mapping[str, Any]], where: Sequence[str]
) -> Iterator[tuple[int, Any]]:
    """The results of `solve` or `validate` for some arguments, each with its index: see `as_they_come`."""
    at_first = iter([list(zip(calls, where, strict=True))])
    return as_they_come(work, executor, lambda: next(at_first, []))


def as_they_come(
    work: Work,
    executor: Executor,
    more: Callable[[], Iterable[tuple[Mapping[str, Any], str]]],
    *,
    rehearsed: bool = False,
) -> Iterator[tuple[int, Any]]:
    """The results of `solve` or `validate`, each with the number of its call, as soon as they are there.

    `more`: the further calls that can be made by now, each with its place in words, with which its warnings begin. It
    is asked at first, and again whenever a result has been taken. A refusal or a failure of a model is a result: the
    exception. What a journal has is not computed. With `rehearsed`, all of `al.workers` begin with the first calls, so
    that they compile while these are answered. Where the caller stops, what has not begun is cancelled.

    Raises `ProblemError` for models that cannot travel, and `SimulationError` if workers keep dying.
    """
    made = list[_Made]()
    with sending(executor) as sent:
        yield from _recalled(work, executor, sent, made, more, rehearsed=rehearsed)
        for i, receive in sent.done():
            call, entry = made[i]
            try:
                result = receive()
            except SimulationError as error:
                entry.failed(error)
                raise
            if isinstance(result, AleatorError):
                entry.failed(result)
            else:
                result = result if is_of_this_process(executor) else _of_here(result, call)
                entry.keep(result)
            yield i, result
            yield from _recalled(work, executor, sent, made, more)


class _Made(NamedTuple):
    """A call that was made, and the place of its result in the journal."""

    call: Mapping[str, Any]
    entry: AbstractEntry


def _recalled(
    work: Work,
    executor: Executor,
    sent: Sent,
    made: list[_Made],
    more: Callable[[], Iterable[tuple[Mapping[str, Any], str]]],
    *,
    rehearsed: bool = False,
) -> Iterator[tuple[int, Any]]:
    """Make the calls that can be made by now: those results that a journal has; the others are sent for."""
    done = {"solve": _solved, "validate": _validated}[work]
    while calls := list(more()):
        first = len(made)
        made += [_Made(call, entry_of(work, _GIVEN[work](**call))) for call, _ in calls]
        fresh = range(first, len(made))
        packs = {i: packed(executor, done, made[i].call) for i in fresh if made[i].entry.recalled is None}
        if rehearsed and not first and isinstance(executor, Workers):
            for pack in packs.values():
                executor.rehearse(run, pack)
        for i, pack in packs.items():
            sent.send(i, pack, calls[i - first][1])
        yield from ((i, made[i].entry.recalled) for i in fresh if i not in packs)


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
