"""Descent along the floor of a steep valley, where a small gradient does not yet mean a minimum."""

from typing import NamedTuple

import numpy as np

from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._scales import Multipliers
from aleator.nlp._scaling import ScaledProgram

# Most variables for which second derivatives are taken from differences of gradients, two for each.
_MOST = 30
# A change of the objective by less than this part of it, and of the variables by less than this, is none.
_NOTICEABLE = 1e-3
# A fall that no point shows may be rounding if it is less than this part of the objective at the start.
_ROUNDING = 1e-14
# Size of a differencing step in typical magnitudes.
_STEP = 1e-4
# Curvature below this part of the largest is rounding.
_FLAT = 1e-13
# Shares of Newton's step that are tried.
_SHARES = (1.0, 0.25, 0.0625)
# A limit that forbids even this share of it stands in its way.
_LEAST_SHARE = 1e-6


class Descent(NamedTuple):
    """A noticeable descent, for example along the floor of a valley.

    - `fall`: of the objective by Newton's method, in user units; `slope`: the largest entry of the scaled gradient;
    - `point`: one that is lower indeed, shape (n_free,); None if the floor is too curved for a step along it;
    - `where`: it is, in words; `is_doubtful`: whether no point shows it: nothing falls along it, or a limit forbids it.
    """

    fall: float
    slope: float
    point: np.ndarray | None
    where: str
    is_doubtful: bool = False


def descent_in_valley(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers) -> Descent | None:
    """The descent along the floor of a valley at a point where no constraint acts; None if there is none.

    A solver that approximates second derivatives may stop on the floor of a valley whose walls are steep, as those of
    large penalties are: beside their curvature the gradient along the floor is nothing. Second derivatives are taken
    only where that gradient would change the objective noticeably over a typical magnitude of the variables.
    """
    if z.size > _MOST or multipliers.rows.any():
        return None
    free = multipliers.bounds == 0
    slope = np.where(free, scaled.evaluate(z).gradient, 0.0)
    typical, largest = max(1.0, float(np.abs(z).max())), float(np.abs(slope).max(initial=0.0))
    size = abs(scaled.evaluations.at(scaled.unscaled(z)).objective) / scaled.objective_scale
    noticeable = _NOTICEABLE * size
    if largest * typical <= noticeable:
        return None
    try:
        step = _newton_step(scaled, z, slope, free, _STEP * typical)
    except NotFiniteError:
        return None
    fall = -float(slope @ step) / 2
    if fall <= noticeable or float(np.abs(step).max()) <= _NOTICEABLE * typical:
        return None
    lower, is_doubtful = _lowest(scaled, z, step, noticeable)
    if lower is None and fall <= _ROUNDING * scaled.start_objective:
        return None
    return Descent(fall * scaled.objective_scale, largest, lower, "it is on the floor of a steep valley", is_doubtful)


def _newton_step(scaled: ScaledProgram, z: np.ndarray, slope: np.ndarray, free: np.ndarray, step: float) -> np.ndarray:
    """Newton's step in the free variables. Raises `NotFiniteError` where the model has no value close by."""
    places = np.flatnonzero(free)
    columns = []
    for place in places:
        unit = step * (np.arange(z.size) == place)
        above, below = (np.clip(z + sign * unit, scaled.lower, scaled.upper) for sign in (1, -1))
        change = scaled.evaluate(above).gradient - scaled.evaluate(below).gradient
        columns.append(change[places] / (above[place] - below[place]))
    curvature = np.array(columns)
    values, directions = np.linalg.eigh((curvature + curvature.T) / 2)
    along = directions.T @ slope[places]
    sure = np.abs(values) > _FLAT * np.abs(values).max(initial=0.0)
    whole = np.zeros(z.size)
    whole[places] = -directions[:, sure] @ (along[sure] / np.abs(values[sure]))
    return whole


def _lowest(
    scaled: ScaledProgram, z: np.ndarray, step: np.ndarray, noticeable: float
) -> tuple[np.ndarray | None, bool]:
    """The first share of a step that is feasible and lowers the objective noticeably; and whether none even seems to,
    since the objective falls at no share, or limits forbid any.
    """
    before, falls = scaled.evaluate(z).objective, False
    for share in _SHARES:
        moved = np.clip(z + share * step, scaled.lower, scaled.upper)
        try:
            there = scaled.evaluate(moved)
        except NotFiniteError:
            continue
        if there.objective < before - noticeable:
            if float(scaled.violation(there.constraints).max(initial=0.0)) <= 0:
                return moved, False
            falls = True
    return None, not falls or _is_held(scaled, z + _LEAST_SHARE * step)


def _is_held(scaled: ScaledProgram, point: np.ndarray) -> bool:
    """Whether even a point this close breaks a limit."""
    try:
        found = scaled.evaluate(np.clip(point, scaled.lower, scaled.upper))
    except NotFiniteError:
        return True
    return bool(np.any(scaled.violation(found.constraints) > 0))
