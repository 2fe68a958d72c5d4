"""Descent that first-order conditions hide: along the floor of a steep valley, where a small gradient is no proof of a
minimum, and by decisions whose slopes are nothing beside a larger one, although they are large for themselves.

Stationarity is relative to the largest term of the Lagrangian's gradient. A weight of 1e8 on one decision hides
all that others could still gain: solvers end as soon as the rest is a hundred-millionth. So every decision is compared
with its own terms, and what is left is tried.
"""

from typing import NamedTuple

import numpy as np

from aleator.nlp._certificate import lagrangian_gradient
from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram

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
# Shares of a step that are tried, the largest three of Newton's.
_SHARES = (1.0, 0.25, 0.0625, 0.015625)
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
    for share in _SHARES[:3]:
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


# A slope below this part of its own terms, or of its change over a typical magnitude of the variable, is none.
_OWN = 1e-3
# A fall by less than this part of the larger objective at the start is none.
_BESIDE_START = 1e-8
# In typical magnitudes of variables: tolerances leave shorter steps, whose fall is none unless it is a large part.
_SHORT = 1e-4
# A fall below this part of all terms may be rounding.
_TERMS_ROUNDING = 1e-13
# How close to its bound a row holds a step back, and how close it may have a multiplier.
_CLOSE, _NEAR = 1e-6, 1e-4
# A step that crosses a row before this share of it goes along that row.
_SOON = 0.25
# The part of the predicted fall that a share of a step must bring.
_BROUGHT = 0.1


def hidden_descent(scaled: ScaledProgram, z: np.ndarray, multipliers: Multipliers) -> Descent | None:
    """A descent by variables whose slopes are small beside others but not beside their own terms; None if none is.

    One evaluation if some slope might matter; up to eight more if it is not explained by curvature.
    """
    if not isinstance(scaled.sparsity, np.ndarray):
        return None
    here = scaled.evaluate(z)
    multipliers = _of_near(scaled, z, here, multipliers)
    slope = lagrangian_gradient(here, multipliers)
    room = np.minimum(np.where(slope > 0, z - scaled.lower, scaled.upper - z), np.maximum(1.0, np.abs(z)))
    noticeable = _noticeable(scaled, here, multipliers, z)
    pushes = np.abs(multipliers.rows)[:, None] * np.abs(here.jacobian)
    own = np.maximum(pushes.max(axis=0, initial=0.0), np.abs(multipliers.bounds))
    hidden = (np.abs(slope) > _OWN * own) & (room > 0)
    if float((np.abs(slope) * room)[hidden].sum()) <= noticeable:
        return None
    try:
        reach = _reach(scaled, z, slope, np.where(hidden, room, 0.0), multipliers)
        whole = -np.sign(slope) * reach
        shares = _shares_to_rows(scaled, here, whole)
        lower = None
        # First along the rows that a step would soon cross, then up to them.
        for held in (shares < _SOON, shares <= 0):
            step = _along_rows(scaled, z, here, whole, held | (multipliers.rows != 0), multipliers)
            longest = min(1.0, float(shares[~held].min(initial=1.0)))
            lower = lower or _lower(scaled, z, slope, longest * step, multipliers, noticeable)
    except NotFiniteError:
        return None
    if lower is None:
        return None
    fall, point = lower
    largest = float(np.abs(slope[reach > 0]).max())
    return Descent(fall * scaled.objective_scale, largest, point, "it is beside a slope that larger ones hide")


def _of_near(scaled: ScaledProgram, z: np.ndarray, here: Evaluation, multipliers: Multipliers) -> Multipliers:
    """The multipliers of rows and bounds close by: beside a large one, interior points leave others anywhere."""
    beyond = np.maximum(z - scaled.upper, scaled.lower - z)
    return Multipliers(
        np.where(scaled.violation(here.constraints) > -_NEAR, multipliers.rows, 0.0),
        np.where(beyond > -_NEAR, multipliers.bounds, 0.0),
    )


def _noticeable(scaled: ScaledProgram, here: Evaluation, multipliers: Multipliers, z: np.ndarray) -> float:
    """The least fall of the scaled objective that counts."""
    objective = abs(scaled.evaluations.at(scaled.unscaled(z)).objective) / scaled.objective_scale
    start = scaled.start_objective
    terms = objective + start + float(np.abs(multipliers.rows) @ np.abs(here.constraints))
    return max(min(_NOTICEABLE * objective, _BESIDE_START * (objective + start)), _TERMS_ROUNDING * terms)


def _reach(
    scaled: ScaledProgram, z: np.ndarray, slope: np.ndarray, room: np.ndarray, multipliers: Multipliers
) -> np.ndarray:
    """How far each variable may go: within its room, and to where curvature ends the fall; zero if that is close by."""
    moved = np.clip(z - _STEP * np.sign(slope) * room, scaled.lower, scaled.upper)
    curvature = np.abs(lagrangian_gradient(scaled.evaluate(moved), multipliers) - slope) / _STEP
    explained = np.abs(slope) <= _OWN * curvature
    shares = np.divide(np.abs(slope), curvature, out=np.ones_like(slope), where=curvature > np.abs(slope))
    return np.where(explained, 0.0, shares * room)


def _shares_to_rows(scaled: ScaledProgram, here: Evaluation, step: np.ndarray) -> np.ndarray:
    """The share of a step after which each row reaches its bound, by its slope; zero for a row at it."""
    change, values = here.jacobian @ step, here.constraints
    slack = np.where(change > 0, scaled.constraint_upper - values, values - scaled.constraint_lower)
    shares = np.divide(slack, np.abs(change), out=np.full(slack.shape, np.inf), where=change != 0)
    return np.where(scaled.violation(values) > -_CLOSE, 0.0, shares)


def _along_rows(
    scaled: ScaledProgram,
    z: np.ndarray,
    here: Evaluation,
    step: np.ndarray,
    held: np.ndarray,
    multipliers: Multipliers,
) -> np.ndarray:
    """The step with what leaves the rows `held` removed, by all variables that no bound holds."""
    if not held.any():
        return step
    room = np.minimum(np.minimum(z - scaled.lower, scaled.upper - z), 1.0)
    reach = np.where(step != 0, np.abs(step), np.where(multipliers.bounds == 0, room, 0.0))
    rows = dense_rows(here.jacobian, np.flatnonzero(held)) * reach
    units = np.sign(step)
    return reach * (units - np.linalg.lstsq(rows, rows @ units, rcond=None)[0])


def _lower(
    scaled: ScaledProgram,
    z: np.ndarray,
    slope: np.ndarray,
    step: np.ndarray,
    multipliers: Multipliers,
    noticeable: float,
) -> tuple[float, np.ndarray | None] | None:
    """By how much the Lagrangian falls along a share of the step, and the point there, or None for one that leaves the
    rows; None if it does not fall noticeably.
    """
    before, free = _lagrangian(scaled.evaluate(z), multipliers), multipliers.rows == 0
    for share in _SHARES:
        moved = np.clip(z + share * step, scaled.lower, scaled.upper)
        predicted = -float(slope @ (moved - z))
        if predicted <= noticeable:
            return None
        there = scaled.evaluate(moved)
        fall = before - _lagrangian(there, multipliers) - float(multipliers.bounds @ (moved - z))
        if np.abs(moved - z).max() < _SHORT and fall < _NOTICEABLE * abs(before):
            return None
        outside = float(scaled.violation(there.constraints)[free].max(initial=-np.inf))
        if outside <= _CLOSE and fall >= max(_BROUGHT * predicted, noticeable):
            return fall, moved if free.all() and outside <= 0 else None
    return None


def _lagrangian(evaluation: Evaluation, multipliers: Multipliers) -> float:
    return evaluation.objective + float(multipliers.rows @ evaluation.constraints)
