"""Arguments of `solve`: what is refused, and where they say to start."""

from collections.abc import Mapping
from concurrent.futures import Executor
from typing import Any

import numpy as np

from aleator._core.elsewhere import check_executor
from aleator._core.errors import ProblemError
from aleator._core.given import whole
from aleator.design import Problem
from aleator.nlp import AbstractSearch, AbstractSolver
from aleator.solution import Solution
from aleator.transcription import AbstractTranscription, started_from

# The finest accuracy of a grid that may be asked for.
_FINEST = 1e-9


def check_arguments(
    problem: Problem,
    solver: AbstractSolver,
    warm_start: Solution | None,
    deterministic_first: bool,
    between: int | None,
    accuracy: float,
    executor: Executor | None,
) -> None:
    """Raise `ProblemError` unless the arguments are what `solve` expects."""
    if not isinstance(problem, Problem):
        raise ProblemError(f"solve: expected a Problem; received {type(problem).__name__}.")
    if not isinstance(solver, AbstractSolver):
        raise ProblemError(f"solve: expected a solver, such as al.solvers.Ipopt(); received {solver!r}.")
    if between is not None:
        whole("solve: between", between)
    if isinstance(accuracy, bool) or not isinstance(accuracy, int | float) or not _FINEST <= accuracy < 1:
        raise ProblemError(
            f"solve: expected `accuracy` as a number from {_FINEST:g} (64-bit arithmetic gives no more) to below 1; "
            f"received {accuracy!r}."
        )
    if isinstance(solver, AbstractSearch):
        check_search("solve", problem, solver)
    _check_shared(solver, executor)
    if not isinstance(deterministic_first, bool):
        raise ProblemError(f"solve: expected True or False as `deterministic_first`; received {deterministic_first!r}.")
    if warm_start is None:
        return
    if deterministic_first:
        raise ProblemError(
            "solve: expected either `warm_start` or `deterministic_first`, for each says where to start; received both."
        )
    if not isinstance(warm_start, Solution):
        raise ProblemError(f"solve: expected a Solution as `warm_start`; received {type(warm_start).__name__}.")
    if warm_start.problem.names != problem.names:
        raise ProblemError(
            "solve: a warm start is a solution of a problem with the same constraints; expected "
            f"{list(problem.names)}; received {list(warm_start.problem.names)}."
        )


def _check_shared(solver: AbstractSolver, executor: Executor | None) -> None:
    """Refuse an executor that would have nothing to do."""
    check_executor("solve", executor)
    if executor is not None and not (isinstance(solver, AbstractSearch) and solver.at_once):
        raise ProblemError(
            "solve: executor: expected a solver that evaluates many designs at once, such as "
            f"al.solvers.DifferentialEvolution(); received {type(solver).__name__}, which goes from one design to the "
            "next. al.multistart, al.portfolio and al.pareto share several solves."
        )


def check_search(
    what: str, problem: Problem, solver: AbstractSearch, remedy: str = "al.solvers.NelderMead() needs none."
) -> None:
    """Refuse, by name, what a search without derivatives cannot decide or hold."""
    places, who = problem.placements, type(solver).__name__
    lower, upper = places.vector("lower"), places.vector("upper")
    if solver.needs_bounds and not (closed := np.isfinite(lower) & np.isfinite(upper)).all():
        name = places.entry_names()[int(np.flatnonzero(~closed)[0])]
        if name.endswith(".excess"):
            remedy = "al.soft(..., exact=True, most=...) bounds a slack."
        raise ProblemError(
            f"{what}: {who} searches between bounds: expected finite bounds of every decision; '{name}' has none on at "
            f"least one side. {remedy}"
        )
    equal = [one for one in problem.constraints if float(one.lower) == float(one.upper)]
    if equal and not solver.polish:
        raise ProblemError(
            f"{what}: {who} without polishing cannot hold an equality: expected limits alone, or polish=True; received "
            f"'{equal[0].name}' ({equal[0]})."
        )


def first_decisions(
    problem: Problem,
    transcription: AbstractTranscription,
    warm_start: Solution | None,
    start: Mapping[str, Any] | None,
) -> np.ndarray | None:
    """The decisions to start from; None for their own initial values."""
    places = problem.placements
    if start is None:
        return None if warm_start is None else started_from(problem, warm_start)
    # What is given is checked first.
    moved = places.moved(transcription.first(problem) if warm_start is None else places.vector("initial"), start)
    return moved if warm_start is None else places.moved(started_from(problem, warm_start, start), start)
