"""`solve`: the stages of a solution, in order."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from aleator._core import clock
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError, SolveError
from aleator.collocation import UNRESOLVED
from aleator.design import ConstraintResult, ExpansionQuality, Moments, Problem, Solution, Times
from aleator.nlp import AbstractSolver, Outcome, Status, default_solver
from aleator.transcription import Resolved, Sequential, compile_seconds, diagnose, transcribe


def solve(
    problem: Problem,
    solver: AbstractSolver | None = None,
    *,
    warm_start: Solution | None = None,
    throw: bool = True,
) -> Solution:
    """Solve a design problem: transcribe, compile once, optimise with exact derivatives, certify.

    - `solver`: `FilterSQP()` by default; `Ipopt()` or `Slsqp()` for a second opinion;
    - `warm_start`: a solution of a problem with the same decisions and constraints, to start from;
    - `throw`: if False, a solution that failed is returned with its status instead of raised.

    Raises `SolveError` (which carries the unfinished solution), `SimulationError` if the model gives numbers that are
    not finite, `ProblemError` if there is nothing to decide. Warns with `ExpansionWarning` if an expansion is not
    resolved.
    """
    solver = solver or default_solver()
    _check_arguments(problem, solver, warm_start)
    compiled_before = compile_seconds()
    transcription = transcribe(problem)
    outcome = _optimise(transcription, solver, warm_start)
    if outcome.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if outcome.failed_at is not None:
        outcome = replace(outcome, message=diagnose(transcription, outcome.failed_at))
    solution = _report(transcription, outcome, compiled_before)
    if throw and outcome.status is Status.EVALUATION_FAILED:
        raise SimulationError(outcome.message)
    if throw and not solution.ok:
        raise SolveError(solution.why(), solution)
    _warn_if_unresolved(solution)
    return solution


def _check_arguments(problem: Problem, solver: AbstractSolver, warm_start: Solution | None) -> None:
    if not isinstance(problem, Problem):
        raise ProblemError(f"solve: expected a Problem; received {type(problem).__name__}.")
    if not isinstance(solver, AbstractSolver):
        raise ProblemError(f"solve: expected a solver, such as al.Ipopt(); received {solver!r}.")
    if warm_start is None:
        return
    names = problem.survey.entry_names()
    if warm_start.problem.survey.entry_names() != names or warm_start.problem.names != problem.names:
        raise ProblemError(
            "solve: a warm start is a solution of a problem with the same decisions and constraints; expected "
            f"decisions {list(names)} and constraints {list(problem.names)}."
        )


def _optimise(transcription: Sequential, solver: AbstractSolver, warm_start: Solution | None) -> Outcome:
    if warm_start is None:
        return solver.solve(transcription.program)
    return solver.solve(transcription.program, start=warm_start.vector, multipliers=warm_start.multipliers)


def _report(transcription: Sequential, outcome: Outcome, compiled_before: float) -> Solution:
    problem, places = transcription.problem, transcription.places
    resolved = transcription.resolve(outcome.decisions)
    return Solution(
        problem=problem,
        status=outcome.status,
        decisions=_plain(places.named(outcome.decisions)),
        vector=outcome.decisions,
        objective=outcome.evaluation.objective,
        constraints=_constraint_results(transcription, outcome),
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
        expansion=_quality(transcription, resolved),
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(transcription: Sequential, outcome: Outcome) -> tuple[ConstraintResult, ...]:
    times = np.asarray(transcription.traced.grid.times)
    results = []
    for constraint, rows, scale in zip(
        transcription.problem.constraints, transcription.rows, transcription.scales, strict=True
    ):
        instants = times if constraint.is_path else None
        values, multipliers, active = (
            _shaped(part[rows], instants)
            for part in (outcome.evaluation.constraints, outcome.multipliers, outcome.active)
        )
        results.append(
            ConstraintResult(
                name=constraint.name,
                text=str(constraint),
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


def _quality(transcription: Sequential, resolved: Mapping[str, Resolved]) -> ExpansionQuality:
    times = np.asarray(transcription.traced.grid.times)
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
    if not quality.unresolved:
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
