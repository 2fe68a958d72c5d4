"""From the end of a nonlinear program back to the `Solution` of a problem."""

from typing import Any

import numpy as np

from aleator._core import clock
from aleator.design import (
    Between,
    ConstraintResult,
    GridError,
    Moments,
    Solution,
    Times,
    WorstCase,
    expanded_functionals,
)
from aleator.nlp import Outcome
from aleator.transcription._quality import quality_of
from aleator.transcription._rows import as_read
from aleator.transcription._sequential import Sequential, compile_seconds


def solution_of(
    transcription: Sequential,
    outcome: Outcome,
    between: Between | None,
    error: GridError | None,
    worst_case: WorstCase | None,
    compiled_before: float,
) -> Solution:
    """The solution that an outcome stands for, in the problem's own words.

    `between`, `error`, `worst_case`: what was found of it; `compiled_before`: what compilations had taken before, s.
    """
    problem, places = transcription.problem, transcription.places
    resolved = transcription.resolve(outcome.decisions)
    times = transcription.times(outcome.decisions)
    # Limits on the worst case ask the model itself.
    asked = {one.text() for one in expanded_functionals(problem.expressions)}
    expanded = {text: one for text, one in resolved.items() if text in asked}
    return Solution(
        problem=problem,
        status=outcome.status,
        decisions=_plain(places.named(outcome.decisions)),
        vector=outcome.decisions,
        objective=outcome.evaluation.objective,
        constraints=_constraint_results(transcription, outcome, times),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved.items()},
        statistics=transcription.statistics(outcome.decisions),
        idle=tuple(places.entry_names()[i] for i in outcome.idle),
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
        worst_case=worst_case,
        expansion=quality_of(transcription, expanded, outcome.decisions),
        grid_error=error,
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(transcription: Sequential, outcome: Outcome, times: np.ndarray) -> tuple[ConstraintResult, ...]:
    results = []
    each = transcription.texts.constraints, transcription.rows
    for constraint, text, rows in zip(transcription.problem.constraints, *each, strict=True):
        instants = times if constraint.is_path else None
        parts = outcome.evaluation.constraints[rows], outcome.multipliers[rows], outcome.active[rows]
        values, multipliers, active = (
            _shaped(part, instants) for part in as_read(constraint, transcription.scenarios, *parts)
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
                scale=float(outcome.sizes[rows].max()),
            )
        )
    return tuple(results)


def _shaped(rows: np.ndarray, times: np.ndarray | None) -> np.ndarray:
    """A constraint's rows by instant, where it has several at each."""
    return rows if times is None or len(rows) == len(times) else rows.reshape(len(times), -1)
