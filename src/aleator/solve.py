"""`solve`: the stages of a solution, in order."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from aleator._core import clock
from aleator._core.errors import ExpansionWarning, SimulationError, SolveError
from aleator.design import ConstraintResult, ExpansionQuality, Moments, Problem, Solution, Times, functionals_of
from aleator.nlp import AbstractSolver, Outcome, Status, default_solver
from aleator.transcription import EVALUATE, Resolved, Sequential, diagnose, transcribe

# Above this relative squared error an expansion predicts a new sample to worse than a fifth of its spread.
UNRESOLVED = 0.05


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
    compiled_before = EVALUATE.seconds
    transcription = transcribe(problem)
    compile_seconds = EVALUATE.seconds - compiled_before
    outcome = _optimise(transcription, solver or default_solver(), warm_start)
    if outcome.status is Status.EVALUATION_FAILED:
        raise SimulationError(diagnose(transcription, outcome.decisions))
    solution = _report(transcription, outcome, compile_seconds)
    if outcome.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if throw and not solution.ok:
        raise SolveError(solution.why(), solution)
    _warn_if_unresolved(solution)
    return solution


def _optimise(transcription: Sequential, solver: AbstractSolver, warm_start: Solution | None) -> Outcome:
    if warm_start is None:
        return solver.solve(transcription.program)
    return solver.solve(transcription.program, start=warm_start.vector, multipliers=warm_start.multipliers)


def _report(transcription: Sequential, outcome: Outcome, compile_seconds: float) -> Solution:
    problem, places = transcription.problem, transcription.places
    functionals = functionals_of(problem.expressions)
    resolved = {
        one.text(): result for one, result in zip(functionals, transcription.resolve(outcome.decisions), strict=True)
    }
    return Solution(
        problem=problem,
        status=outcome.status,
        decisions=_plain(places.named(outcome.decisions)),
        vector=outcome.decisions,
        objective=outcome.evaluation.objective,
        constraints=_constraint_results(transcription, outcome),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved.items()},
        bound_multipliers=_plain(places.named(outcome.bound_multipliers)),
        multipliers=outcome.multipliers,
        violation=outcome.violation,
        stationarity=outcome.stationarity,
        complementarity=outcome.complementarity,
        iterations=outcome.iterations,
        evaluations=outcome.evaluations,
        times=Times(clock.import_seconds, compile_seconds, outcome.seconds),
        solver=outcome.solver,
        message=outcome.message,
        expansion=_quality(transcription, resolved),
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(transcription: Sequential, outcome: Outcome) -> tuple[ConstraintResult, ...]:
    times = np.asarray(transcription.traced.grid.times)
    scale = transcription.program.constraint_scale
    results = []
    for constraint, rows in zip(transcription.problem.constraints, transcription.rows, strict=True):
        shape = (len(times), -1) if constraint.is_path else ()
        values, multipliers, size = (
            part[rows] for part in (outcome.evaluation.constraints, outcome.multipliers, scale)
        )
        lower, upper = float(constraint.lower), float(constraint.upper)
        gap = np.minimum(np.abs(values - lower), np.abs(upper - values))
        # A multiplier says that the bound matters; a bound that is met without one (degenerate) counts as well.
        active = (gap <= 1e-6 * size) | (
            np.abs(multipliers) * size > 1e-6 * max(1.0, abs(outcome.evaluation.objective))
        )
        values, multipliers, active = (
            part.reshape(shape).squeeze() if constraint.is_path else part.reshape(-1)
            for part in (values, multipliers, active)
        )
        results.append(
            ConstraintResult(
                constraint.name,
                str(constraint),
                lower,
                upper,
                values,
                times if constraint.is_path else None,
                multipliers,
                active,
            )
        )
    return tuple(results)


def _quality(transcription: Sequential, resolved: Mapping[str, Resolved]) -> ExpansionQuality:
    variables = len(transcription.places.distributions)
    expansion = transcription.problem.expansion
    return ExpansionQuality(
        order=expansion.order,
        terms=expansion.terms(variables),
        points=expansion.point_count(variables),
        condition_number=float(transcription.collocation.condition_number),
        leave_one_out={text: float(one.leave_one_out) for text, one in resolved.items()},
    )


def _warn_if_unresolved(solution: Solution) -> None:
    bad = {text: error for text, error in solution.expansion.leave_one_out.items() if not error <= UNRESOLVED}
    if bad:
        listed = ", ".join(f"{text} ({error:.2g})" for text, error in bad.items())
        warnings.warn(
            f"The expansion of order {solution.expansion.order} does not resolve {listed}: its relative leave-one-out "
            f"error exceeds {UNRESOLVED}, so means and spreads cannot be trusted. Raise the order, and compare with "
            "al.validate.",
            ExpansionWarning,
            stacklevel=3,
        )
