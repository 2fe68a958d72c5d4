"""`solve`: the stages of a solution, in order."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from aleator._core import clock
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError, SolveError
from aleator.collocation import UNRESOLVED
from aleator.design import (
    HELD,
    TOLERATED,
    Between,
    ConstraintResult,
    ExpansionQuality,
    Moments,
    Problem,
    Solution,
    Times,
    is_over_time,
)
from aleator.dynamics import Grid
from aleator.nlp import AbstractSolver, Outcome, Status, default_solver
from aleator.transcription import (
    Excess,
    Resolved,
    Sequential,
    compile_seconds,
    diagnose,
    excess_between,
    margins_for,
    no_margins,
    tightened,
    transcribe,
)
from aleator.uncertainty import Survey

# How often limits between instants are tightened, until they hold or it is given up.
_MOST_TIGHTENINGS = 12


def solve(
    problem: Problem,
    solver: AbstractSolver | None = None,
    *,
    warm_start: Solution | None = None,
    start: Mapping[str, Any] | None = None,
    between: int | None = None,
    throw: bool = True,
) -> Solution:
    """Solve a design problem: transcribe, compile once, optimise with exact derivatives, certify.

    - `solver`: `FilterSQP()` by default; `Ipopt()` or `Slsqp()` for a second opinion;
    - `warm_start`: a solution of a problem with the same decisions and constraints, to start from, on the same grid or
      another;
    - `start`: values of decisions by name to start from, in the place of their own initial ones;
    - `between`: limits over time are checked on a grid of so many times as many steps as well, and where they are
      exceeded between two instants, the bounds there are tightened until they hold; a solution that exceeds one by more
      than a thousandth of it nevertheless has failed. 1 leaves all that out. By default 10 for systems that follow
      trajectories, 1 for others;
    - `throw`: if False, a solution that failed is returned with its status instead of raised.

    Raises `SolveError` (which carries the unfinished solution), `SimulationError` if the model gives numbers that are
    not finite, `ProblemError` if there is nothing to decide. Warns with `ExpansionWarning` if an expansion is not
    resolved.
    """
    solver = solver or default_solver()
    _check_arguments(problem, solver, warm_start, between)
    compiled_before = compile_seconds()
    transcription = transcribe(problem)
    outcome = _optimise(transcription, solver, _first(transcription.places, warm_start, start), warm_start)
    factor = _factor(problem, between)
    outcome, excess = _held_between(transcription, solver, outcome, factor)
    if outcome.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if outcome.failed_at is not None:
        outcome = replace(outcome, message=diagnose(transcription, outcome.failed_at))
    if excess is not None and excess.worst > TOLERATED:
        outcome = replace(outcome, status=Status.NOT_HELD)
    found = None if excess is None else Between(factor, *excess[1:])
    solution = _report(transcription, outcome, found, compiled_before)
    if throw and outcome.status is Status.EVALUATION_FAILED:
        raise SimulationError(outcome.message)
    if throw and not solution.ok:
        raise SolveError(solution.why(), solution)
    _warn_if_unresolved(solution)
    return solution


def _check_arguments(
    problem: Problem, solver: AbstractSolver, warm_start: Solution | None, between: int | None
) -> None:
    if not isinstance(problem, Problem):
        raise ProblemError(f"solve: expected a Problem; received {type(problem).__name__}.")
    if not isinstance(solver, AbstractSolver):
        raise ProblemError(f"solve: expected a solver, such as al.Ipopt(); received {solver!r}.")
    if between is not None and not (isinstance(between, int | np.integer) and between >= 1):
        raise ProblemError(f"solve: expected `between` as a whole number of at least 1; received {between!r}.")
    if warm_start is None:
        return
    if not isinstance(warm_start, Solution):
        raise ProblemError(f"solve: expected a Solution as `warm_start`; received {type(warm_start).__name__}.")
    names = problem.survey.entry_names()
    if warm_start.problem.survey.entry_names() != names or warm_start.problem.names != problem.names:
        raise ProblemError(
            "solve: a warm start is a solution of a problem with the same decisions and constraints; expected "
            f"decisions {list(names)} and constraints {list(problem.names)}."
        )


def _first(places: Survey, warm_start: Solution | None, start: Mapping[str, Any] | None) -> np.ndarray | None:
    """The decisions to start from; None for their own initial values."""
    if start is None:
        return None if warm_start is None else warm_start.vector
    return places.moved(places.vector("initial") if warm_start is None else warm_start.vector, start)


def _factor(problem: Problem, between: int | None) -> int:
    """How many times finer the grid is on which limits over time are checked; 1 for none."""
    if not (isinstance(problem.grid, Grid) and any(map(is_over_time, problem.constraints))):
        return 1
    return (10 if problem.system.signals() else 1) if between is None else between  # type: ignore[union-attr]


def _optimise(
    transcription: Sequential, solver: AbstractSolver, start: np.ndarray | None, warm_start: Solution | None
) -> Outcome:
    rows = transcription.program.constraint_lower.shape
    # Prices at the instants of another grid say nothing here.
    known = None if warm_start is None else warm_start.multipliers
    multipliers = known if known is not None and known.shape == rows else None
    return solver.solve(transcription.program, start=start, multipliers=multipliers)


def _held_between(
    transcription: Sequential, solver: AbstractSolver, outcome: Outcome, factor: int
) -> tuple[Outcome, Excess | None]:
    """The solution whose limits hold between instants too, by margins where they do not; and how far it exceeds
    them.
    """
    if factor == 1 or outcome.status is not Status.SOLVED:
        return outcome, None
    excess = excess_between(transcription, outcome.decisions, factor)
    margins = no_margins(excess)
    for done in range(_MOST_TIGHTENINGS):
        if excess.worst <= HELD:
            break
        # At first nothing is given away; then it must come to an end.
        margins = margins_for(margins, excess, relax=done < _MOST_TIGHTENINGS // 2)
        again = solver.solve(
            tightened(transcription, margins), start=outcome.decisions, multipliers=outcome.multipliers
        )
        if again.status is Status.INTERRUPTED:
            return again, None
        if again.status is not Status.SOLVED:
            break
        seconds, iterations = outcome.seconds + again.seconds, outcome.iterations + again.iterations
        evaluations = outcome.evaluations + again.evaluations
        outcome = replace(again, seconds=seconds, iterations=iterations, evaluations=evaluations)
        excess = excess_between(transcription, outcome.decisions, factor)
    return outcome, excess


def _report(transcription: Sequential, outcome: Outcome, between: Between | None, compiled_before: float) -> Solution:
    problem, places = transcription.problem, transcription.places
    resolved = transcription.resolve(outcome.decisions)
    times = transcription.times(outcome.decisions)
    return Solution(
        problem=problem,
        status=outcome.status,
        decisions=_plain(places.named(outcome.decisions)),
        vector=outcome.decisions,
        objective=outcome.evaluation.objective,
        constraints=_constraint_results(transcription, outcome, times),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved.items()},
        statistics=transcription.statistics(outcome.decisions),
        at_bounds=tuple(np.array(places.entry_names())[outcome.active_bounds].tolist()),
        bound_multipliers=_plain(places.named(outcome.bound_multipliers)),
        multipliers=outcome.multipliers,
        violation=outcome.violation,
        stationarity=outcome.stationarity,
        complementarity=outcome.complementarity,
        iterations=outcome.iterations,
        evaluations=outcome.evaluations,
        times=Times(clock.import_seconds, compile_seconds() - compiled_before, outcome.seconds),
        solver=outcome.solver,
        message=outcome.message,
        between=between,
        expansion=_quality(transcription, resolved, times),
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(transcription: Sequential, outcome: Outcome, times: np.ndarray) -> tuple[ConstraintResult, ...]:
    results = []
    parts = transcription.texts.constraints, transcription.rows, transcription.scales
    for constraint, text, rows, scale in zip(transcription.problem.constraints, *parts, strict=True):
        instants = times if constraint.is_path else None
        values, multipliers, active = (
            _shaped(part[rows], instants)
            for part in (outcome.evaluation.constraints, outcome.multipliers, outcome.active)
        )
        results.append(
            ConstraintResult(
                name=constraint.name,
                text=text,
                lower=float(constraint.lower),
                upper=float(constraint.upper),
                values=values,
                times=instants,
                multipliers=multipliers,
                active=active,
                scale=scale,
            )
        )
    return tuple(results)


def _shaped(rows: np.ndarray, times: np.ndarray | None) -> np.ndarray:
    """A constraint's rows by instant, where it has several at each."""
    return rows if times is None or len(rows) == len(times) else rows.reshape(len(times), -1)


def _quality(transcription: Sequential, resolved: Mapping[str, Resolved], times: np.ndarray) -> ExpansionQuality:
    followed = {text: int(one.instants) for text, one in resolved.items() if one.instants is not None}
    return ExpansionQuality(
        order=transcription.basis.order,
        terms=transcription.basis.terms,
        points=len(transcription.collocation.points),
        condition_number=float(transcription.collocation.condition_number),
        leave_one_out={text: float(one.leave_one_out) for text, one in resolved.items()},
        unresolved_from={text: float(times[count]) for text, count in followed.items() if count < len(times)},
    )


def _warn_if_unresolved(solution: Solution) -> None:
    quality = solution.expansion
    if solution.status is Status.EVALUATION_FAILED or not quality.unresolved:
        return
    if not quality.can_be_checked:
        problem = (
            f"{quality.points} points for {quality.terms} terms leave nothing to check the expansion of order "
            f"{quality.order} by, so whether means and spreads can be trusted is not known. Use more points"
        )
    else:
        bad = [f"{text} ({quality.leave_one_out[text]:.2g}){quality.since(text)}" for text in quality.unresolved]
        problem = (
            f"The expansion of order {quality.order} does not resolve {', '.join(bad)}: its relative leave-one-out "
            f"error exceeds {UNRESOLVED}, so means and spreads cannot be trusted. Raise the order"
        )
    warnings.warn(f"{problem}, and compare with al.validate.", ExpansionWarning, stacklevel=3)
