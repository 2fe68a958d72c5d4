"""Infeasible near one point, feasible at another: what is tried before a program is called infeasible.

Solvers prove that no small step from where they stand meets all constraints. Where a model saturates, or where a
variable has to grow by many orders of magnitude from a start that says nothing of it, that is not the whole truth.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aleator.nlp._outcome import Outcome, Status
from aleator.nlp._program import NonlinearProgram

# How many points all over the range of the variables are looked at, and how far from the start where that has no end,
# in typical magnitudes.
_POINTS, _FAR = 8, 3.0
# A point is less violated if its violation is lower by more than this part of it.
_LESS = 1e-2


def feasible_elsewhere(
    program: NonlinearProgram,
    outcome: Outcome,
    start: np.ndarray,
    again: Callable[[NonlinearProgram, np.ndarray], Outcome],
) -> Outcome:
    """The outcome, or that of another start if it is called infeasible although some point violates less.

    `again` solves a program from a start: from the least violated of those looked at, `start` (shape (n,)) among them,
    with variables scaled by what they have come to be.
    """
    if outcome.status is not Status.INFEASIBLE:
        return outcome
    points = [start, *_points(program, start)]
    violations = [_violation(program, outcome, point) for point in points]
    best = int(np.argmin(violations))
    if not violations[best] < (1 - _LESS) * outcome.violation:
        return outcome
    scale = np.max(np.abs([program.variable_scale, outcome.point, points[best]]), axis=0)
    found = again(replace(program, variable_scale=scale), points[best])
    if found.status in (Status.SOLVED, Status.INTERRUPTED):
        return found.with_effort_of(outcome)
    return outcome.with_effort_of(found)


def variable_range(
    start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest variables, or three typical magnitudes from the start where their range has no end."""
    far = _FAR * scale
    return np.where(np.isfinite(lower), lower, start - far), np.where(np.isfinite(upper), upper, start + far)


def _points(program: NonlinearProgram, start: np.ndarray) -> list[np.ndarray]:
    """The corners of least and greatest variables, the middle between them, and points all over."""
    lower, upper = variable_range(start, program.lower, program.upper, program.variable_scale)
    generator = np.random.default_rng(0)
    return [lower, upper, (lower + upper) / 2, *generator.uniform(lower, upper, (_POINTS, len(start)))]


def _violation(program: NonlinearProgram, outcome: Outcome, point: np.ndarray) -> float:
    values = program.evaluate(point).constraints
    beyond = np.maximum(values - program.constraint_upper, program.constraint_lower - values) / outcome.sizes
    return float(np.max(beyond, initial=0.0)) if np.isfinite(values).all() else np.inf
