"""Variables that change the objective although every slope of it is zero: a model that rounds, floors or casts.

Stationarity says nothing there: a rounded objective is flat wherever it is looked at, and so any point "optimal".
"""

from collections.abc import Iterator

import numpy as np

from aleator.nlp._program import Evaluation, NonlinearProgram

# Steps in typical magnitudes of all suspects together, and then of each alone: a short one, so that the model is likely
# to be finite, and a long one, across a coarse rounding.
_STEPS = (0.05, -0.4)
# Values that differ by less than this part count as equal.
_SAME = 1e-12
# At most this many variables are told: the first ones.
_MOST = 12


def lost_variables(program: NonlinearProgram, point: np.ndarray, here: Evaluation) -> tuple[int, ...]:
    """Variables by which the slope of the objective is zero at a point and wherever else it is tried, although it
    changes with them.

    Two evaluations if some slope is exactly zero, two more for each of several suspects if the objective changes. In
    sparse programs, where an objective depends on few variables by construction, none is looked for.
    """
    flat = np.flatnonzero((here.gradient == 0) & (program.lower < program.upper))
    if not flat.size or not isinstance(here.jacobian, np.ndarray) or not np.isfinite(here.objective):
        return ()
    if not _are_lost(program, point, here, flat):
        return ()
    return tuple(int(one) for one in flat[:_MOST] if flat.size == 1 or _are_lost(program, point, here, np.array([one])))


def _are_lost(program: NonlinearProgram, point: np.ndarray, here: Evaluation, which: np.ndarray) -> bool:
    """Whether some step of these variables changes the objective without a slope."""
    return any(_changes_blindly(here, there, which) for there in _steps(program, point, which))


def _steps(program: NonlinearProgram, point: np.ndarray, which: np.ndarray) -> Iterator[Evaluation]:
    """Evaluations with some variables moved by each step, away from a bound that is too close."""
    size = program.variable_scale[which]
    for step in _STEPS:
        places = [np.clip(point[which] + sign * step * size, *_bounds(program, which)) for sign in (1, -1)]
        first, second = (np.abs(place - point[which]) for place in places)
        moved = point.copy()
        moved[which] = np.where(first >= second, *places)
        yield program.evaluate(moved)


def _bounds(program: NonlinearProgram, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return program.lower[which], program.upper[which]


def _changes_blindly(here: Evaluation, there: Evaluation, which: np.ndarray) -> bool:
    """Whether the objective differs, although its slopes by what moved are zero at both ends."""
    size = max(abs(here.objective), abs(there.objective))
    differs = np.isfinite(there.objective) and abs(there.objective - here.objective) > _SAME * size
    return bool(differs and not there.gradient[which].any())
