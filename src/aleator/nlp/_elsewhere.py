"""Further starting points that are tried before a program is called infeasible.

Solvers prove that no small step from their point meets all constraints. There may still be a feasible point elsewhere:
if a model saturates, or if a variable must change by many orders of magnitude from a poor start.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aleator.nlp._advice import HELD
from aleator.nlp._outcome import Outcome, Status
from aleator.nlp._program import NonlinearProgram

# How many points in the whole range of the variables are evaluated, and how far from the start an unbounded range
# extends, in typical magnitudes.
_POINTS, _FAR = 8, 3.0
# Bounds that are so many typical magnitudes, or units, away stand for none.
UNBOUNDED = 1e15
# A violation is lower if it is so by more than this part.
_LESS = 1e-2


def feasible_elsewhere(
    program: NonlinearProgram,
    outcome: Outcome,
    start: np.ndarray,
    again: Callable[[NonlinearProgram, np.ndarray], Outcome],
) -> Outcome:
    """The outcome, or that from another start if it is infeasible although some other point violates less.

    `again` solves a program from a start: the least violated of the points evaluated, which include `start` (shape
    (n,)) and the program's own, with variables scaled by their values there. A search that strayed from points that
    meet all constraints starts from the best of these. Where a point meets them, the outcome is not infeasible.
    """
    if outcome.strayed:
        best, is_feasible = outcome.point, True
    elif outcome.status is Status.INFEASIBLE:
        points = [start, program.start, *_points(program, start)]
        violations = [_violation(program, outcome, point) for point in points]
        least = int(np.argmin(violations))
        if not violations[least] < (1 - _LESS) * outcome.violation:
            return outcome
        best, is_feasible = points[least], violations[least] <= HELD
    else:
        return outcome
    scale = np.max(np.abs([program.variable_scale, outcome.point, best]), axis=0)
    found = again(replace(program, variable_scale=scale), best)
    if found.status in (Status.SOLVED, Status.INTERRUPTED) or (is_feasible and _is_better(found, outcome)):
        return found.with_effort_of(outcome)
    return outcome.with_effort_of(found)


def _is_better(found: Outcome, outcome: Outcome) -> bool:
    """Whether an outcome whose search began at a feasible point tells more than the one before it."""
    if not outcome.strayed:
        return found.status is not Status.INFEASIBLE
    return found.violation <= HELD and found.evaluation.objective < outcome.evaluation.objective


def variable_range(
    start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest values of the variables, or three typical magnitudes from the start if unbounded."""
    far, bounded = _FAR * scale, UNBOUNDED * np.maximum(scale, 1.0)
    return np.where(lower > -bounded, lower, start - far), np.where(upper < bounded, upper, start + far)


def _points(program: NonlinearProgram, start: np.ndarray) -> list[np.ndarray]:
    """The corners of least and of greatest values, the middle between them, and points in the whole range."""
    lower, upper = variable_range(start, program.lower, program.upper, program.variable_scale)
    generator = np.random.default_rng(0)
    return [lower, upper, (lower + upper) / 2, *generator.uniform(lower, upper, (_POINTS, len(start)))]


def _violation(program: NonlinearProgram, outcome: Outcome, point: np.ndarray) -> float:
    values = program.evaluate(point).constraints
    beyond = np.maximum(values - program.constraint_upper, program.constraint_lower - values) / outcome.sizes
    return float(np.max(beyond, initial=0.0)) if np.isfinite(values).all() else np.inf
