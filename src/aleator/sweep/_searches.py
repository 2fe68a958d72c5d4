"""The searches of a portfolio, each kept by a journal as soon as it has ended; local ones here or by an executor."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.elsewhere import each_done
from aleator._core.journalled import entry_of, journalled
from aleator._core.progress import silent
from aleator.design import Problem, refuse_other_code
from aleator.nlp import AbstractSearch, AbstractSolver, NonlinearProgram, Outcome, Searched, Status
from aleator.transcription import DEFAULT, transcribe, valued_by


@final
@dataclass(frozen=True)
class FoundGlobally:
    """What a global search found: points that lie apart, best first, and its history.

    - `status`: `Status.INTERRUPTED` if the user ended it.
    """

    candidates: list[Float[np.ndarray, " n"]]
    searched: Searched
    status: Status


def searched_globally(
    problem: Problem, program: NonlinearProgram, search: AbstractSearch, count: int, executor: Executor | None
) -> FoundGlobally:
    """At most `count` points of a global search; from a journal, if one has them.

    An executor finds the values of whole generations, not those of one point after the other.
    """

    def found() -> FoundGlobally:
        sought, searched = search.seek(valued_by(executor if search.at_once else None, program, "portfolio"))
        status = Status.SOLVED if sought.halt is None else Status.INTERRUPTED
        return FoundGlobally(sought.candidates(count), searched, status)

    given = {"problem": problem, "search": replace(search, progress=silent), "count": count}
    return journalled("global search", given, found)


def each_outcome(
    problem: Problem,
    program: NonlinearProgram,
    solver: AbstractSolver,
    points: Sequence[Float[np.ndarray, " n"]],
    executor: Executor | None,
) -> Iterator[tuple[int, Outcome]]:
    """The outcome of a local search from each point, with its index; by an executor as soon as it is there."""
    if executor is not None:
        yield from _by(executor, problem, solver, points)
        return
    for i, point in enumerate(points):
        yield i, journalled("local search", _given(problem, solver, point), lambda: solver.solve(program, start=point))  # noqa: B023 -- called at once


def _by(
    executor: Executor, problem: Problem, solver: AbstractSolver, points: Sequence[Float[np.ndarray, " n"]]
) -> Iterator[tuple[int, Outcome]]:
    entries = [entry_of("local search", _given(problem, solver, point)) for point in points]
    yield from ((i, entry.recalled) for i, entry in enumerate(entries) if entry.recalled is not None)
    missing = [i for i, entry in enumerate(entries) if entry.recalled is None]
    calls = [{"problem": problem, "solver": solver, "point": points[i]} for i in missing]
    places = [f"portfolio, local search {i + 1}" for i in missing]
    for number, outcome in each_done(executor, _searched_there, calls, places):
        entries[missing[number]].keep(outcome)
        yield missing[number], outcome


def _searched_there(problem: Problem, solver: AbstractSolver, point: Float[np.ndarray, " n"]) -> Outcome:
    refuse_other_code(problem)
    return solver.solve(transcribe(problem, DEFAULT).program, start=point)


def _given(problem: Problem, solver: AbstractSolver, point: Float[np.ndarray, " n"]) -> dict[str, Any]:
    return {"problem": problem, "solver": solver, "start": point}
