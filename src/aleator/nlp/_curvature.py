"""What first-order conditions leave open at a point: maxima and saddles, floors of steep valleys, hidden slopes.

Stationarity is relative to the largest term of the Lagrangian's gradient, so that a weight of 1e8 on one decision hides
all that others could still gain; beside the curvature of a valley's walls the gradient along its floor is nothing; and
a start on a line of symmetry is stationary across it. One look tells all of these: second derivatives of the Lagrangian
in the directions that active rows and bounds leave free, by differences of gradients. Newton's step there, and one
along negative curvature, are tried.
"""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._matrices import projected
from aleator.nlp._scaling import MOST_DIFFERENCED, Multipliers, ScaledProgram

# The least fall that counts: this part of the objective, or of the larger one at the start, and no rounding of terms.
_NOTICEABLE, _BESIDE_START, _ROUNDING = 1e-3, 1e-8, 1e-13
# Rows and bounds hold a point if their multipliers are above this, and if they are this close: beside a large
# multiplier, interior points leave others anywhere.
_PRESSES, _NEAR = 1e-7, 1e-4
# Length of a step along negative curvature, in magnitudes of the variables, and the longest that is none.
_LEAVE, _STILL = 0.05, 1e-8
# Curvature below this part of the largest is rounding.
_FLAT = 1e-13
# Directions of which less than this part is left beside the active rows are held by these.
_HELD = 1e-6
# Shares of a step that are tried, and the part of the predicted fall that one must bring.
_TRIED, _BROUGHT = tuple(4.0**-power for power in range(7)), 0.1
# Rows hold if they are exceeded by no more than this, and stand in the way if they are this close.
_CLOSE = 1e-6


class Descent(NamedTuple):
    """A noticeable descent from a point that meets the first-order conditions.

    - `point`: one that is lower indeed, shape (n_free,); `holds`: whether all limits hold there;
    - `fall`: of the objective by the quadratic model, in user units; `slope`: the largest entry of the scaled gradient.
    """

    point: np.ndarray
    holds: bool
    fall: float
    slope: float


def descent(
    scaled: ScaledProgram,
    z: np.ndarray,
    multipliers: Multipliers,
    unmoved: Float[np.ndarray, "n directions"] | None = None,
) -> Descent | None:
    """The descent that first-order conditions hide at a point `z`, shape (n_free,); None if there is none.

    - `unmoved`: directions that no descent has gone, along which the point may be a saddle or a maximum. Without any,
      only slopes that might change the objective noticeably are a reason to look.

    Two evaluations for each direction. Those free of active rows and bounds are looked along if they are few; of more
    than `MOST_DIFFERENCED` variables only the first unmoved ones, along the active rows, and the slope.
    """
    here, size = scaled.evaluate(z), np.maximum(1.0, np.abs(z))
    # Those of rows and bounds close by.
    multipliers = multipliers.kept(scaled.sides.excess(np.append(here.constraints, z)) > -_NEAR)
    slope = multipliers.slope(here)
    presses = np.abs(multipliers.every) > _PRESSES * max(1.0, float(np.abs(here.gradient).max(initial=0.0)))
    free = ~presses[scaled.rows :]
    free &= np.where(slope > 0, z - scaled.lower, np.where(slope < 0, scaled.upper - z, 1.0)) > 0
    unmoved = np.zeros((z.size, 0)) if unmoved is None else unmoved[:, ~unmoved[~free].any(axis=0)]
    if not (unmoved.size or z.size <= MOST_DIFFERENCED or isinstance(scaled.sparsity, np.ndarray)):
        return None  # The slope alone is no reason to factorise thousands of rows.
    # Directions that active rows and bounds leave free, orthonormal in the variables' sizes.
    if unmoved.size:
        units, _ = np.linalg.qr(unmoved[:, :MOST_DIFFERENCED] / size[:, None])
    elif z.size > MOST_DIFFERENCED:
        units = np.where(free, slope * size, 0.0)[:, None]
    else:
        units = np.eye(z.size)[:, free]
    acting = presses[: scaled.rows] | (scaled.constraint_lower == scaled.constraint_upper)
    if acting.any():
        units = projected(here.jacobian[np.flatnonzero(acting)] * (size * free), units)
        left, lengths, _ = np.linalg.svd(units, full_matrices=False)
        units = left[:, lengths > _HELD * lengths.max(initial=_HELD)]
    basis, objective = size[:, None] * units, scaled.objective_size(here)
    least = min(_NOTICEABLE * objective, _BESIDE_START * (objective + scaled.start_objective))
    noticeable = max(least, _ROUNDING * scaled.terms(here, multipliers))
    if not unmoved.size and float(np.abs(slope @ basis).sum()) <= noticeable:
        return None
    try:
        curvature = basis.T @ scaled.curvature(z, multipliers, basis)
    except NotFiniteError:
        return None
    curvatures, mixed = np.linalg.eigh((curvature + curvature.T) / 2)
    # Steps are measured by the variable that they move most: among thousands, a unit vector moves none.
    lengths = np.abs(units @ mixed).max(axis=0)
    directions, curvatures = basis @ mixed / lengths, curvatures / lengths**2
    slopes = slope @ directions
    newton, leave = _steps(curvatures, slopes, noticeable)

    def predicted(share: float) -> float:
        step = share * (np.abs(newton) + leave)
        return float((np.abs(slopes) * step - curvatures * step**2 / 2).sum())

    if predicted(1.0) <= noticeable:
        return None
    lowest, holds = None, False
    for share, sign in itertools.product(_TRIED, (1, -1) if leave.any() else (1,)):
        # A solver that starts close to a saddle returns there, so that length comes first.
        is_far = lowest is not None and unmoved.size and sign == 1
        if holds or is_far or predicted(share) <= noticeable:
            break
        moved = np.clip(z + directions @ (share * (newton + sign * leave)), scaled.lower, scaled.upper)
        try:
            there = scaled.evaluate(moved)
        except NotFiniteError:
            continue
        change = here.objective - there.objective - float(multipliers.bounds @ (moved - z))
        change += float(multipliers.rows @ (here.constraints - there.constraints))
        inside = bool(scaled.limits.excess(there.constraints).max(initial=0.0) <= _CLOSE)
        if change >= max(_BROUGHT * predicted(share), noticeable) and (lowest is None or inside):
            lowest, holds = moved, inside
    # Where no step is lower, differences are rounding. A row that is at its bound may stand in the way of the step.
    rows, signs, gaps = scaled.limits.within(here.constraints)
    towards = signs * (here.jacobian @ (directions @ (newton + leave)))[rows] > 0
    is_equal = scaled.constraint_lower == scaled.constraint_upper
    if lowest is None or (not holds and np.any((gaps <= _CLOSE) & towards & ~is_equal[rows])):
        return None
    return Descent(lowest, holds, predicted(1.0) * scaled.scales.objective, float(np.abs(slope).max()))


def _steps(
    curvatures: Float[np.ndarray, " k"], slopes: Float[np.ndarray, " k"], noticeable: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Newton's step along each direction with the curvature's magnitude, at most the variables' size, and the one that
    leaves a maximum or a saddle, of either sign; no direction has both.
    """
    sizes, steepness = np.abs(curvatures), np.abs(slopes)
    sure = sizes > _FLAT * sizes.max(initial=0.0)
    sizes = np.where(sure, sizes, 0.0)
    longest = np.maximum(sizes, steepness)
    newton = np.divide(-slopes, longest, out=np.zeros_like(slopes), where=longest > 0)
    newton[np.abs(newton) < _STILL] = 0.0
    # Without curvature a step is as long as the variables are, whatever the slope: rounding is none.
    newton[~sure & (steepness <= noticeable / max(slopes.size, 1))] = 0.0
    leaves = (curvatures < 0) & (np.abs(newton) < _LEAVE) & (sizes * _LEAVE**2 / 2 > noticeable)
    return np.where(leaves, 0.0, newton), np.where(leaves, _LEAVE, 0.0)
