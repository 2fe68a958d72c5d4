"""Optimality conditions at a point and its multipliers, computed alike for every solver, in scaled quantities; and what
first-order conditions leave open: maxima and saddles, floors of steep valleys, hidden slopes.
"""

import contextlib
import itertools
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import scipy
from jaxtyping import Float

from aleator.nlp._evaluations import MOST_DIFFERENCED, HaltedError, NotFiniteError
from aleator.nlp._program import Evaluation, Matrix, above_identity, largest_term, nonnegative_fit, projected
from aleator.nlp._scaling import Multipliers, ScaledProgram

# Rows and variables this close to a bound count as active when multipliers are fitted.
_ACTIVE = 1e-5
# Violations are stationary if no step of one typical magnitude of every variable lowers them by this part, and none
# that is longer, to this many magnitudes, by the other. A step is believed that brings half of what it promises, or a
# tenth of it does.
_STATIONARY, _FALL, _FARTHEST, _SHARES = 1e-3, 0.05, 1e5, (1.0, 0.1)
# A step across a kink, in magnitudes of the variables, and the least part by which a slope along it rises there.
_ACROSS, _BENDS = 1e-7, 0.1
# Steps of the simplex method after which a proof is given up.
_MOST_PIVOTS, _MANY = 100_000, 2000


@final
@dataclass(frozen=True)
class Certificate:
    """Residuals of the Karush-Kuhn-Tucker conditions, dimensionless.

    - `violation`: largest `(c - upper) / scale` or `(lower - c) / scale` of a row or variable, at least 0;
    - `stationarity`: `max |∇f + Jᵀλ + μ|`, divided by its largest term `λ_i J_ij` or `μ_j` if that is above 1;
    - `complementarity`: largest product of a multiplier and the slack of its bound (a slack above 1, or a missing
      bound, counts as 1), divided by the largest multiplier if that is above 1.
    """

    violation: float
    stationarity: float
    complementarity: float

    def within(self, violation: float, optimality: float) -> bool:
        """Whether the violation and both optimality residuals are within these tolerances."""
        return self.violation <= violation and max(self.stationarity, self.complementarity) <= optimality


def certify(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, multipliers: Multipliers) -> Certificate:
    """Compute the residuals at `z`, shape (n_free,), with its scaled evaluation.

    Source: Nocedal and Wright 2006, eq. 12.34.
    """
    sides, values, weights = scaled.sides, np.append(evaluation.constraints, z), multipliers.every
    # By terms, not by multipliers, which depend on the scale of the constraints.
    terms = max(1.0, _largest(multipliers.bounds), largest_term(multipliers.rows, evaluation.jacobian))
    return Certificate(
        violation=float(sides.excess(values).max(initial=0.0)),
        stationarity=_largest(multipliers.slope(evaluation)) / terms,
        complementarity=_largest(_products(scaled, values, weights)) / max(1.0, _largest(weights)),
    )


def complementary(
    scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, multipliers: Multipliers, fraction: float
) -> Multipliers:
    """Drop the multipliers whose product with their slack exceeds this fraction of the largest multiplier.

    An interior point leaves such residues far from any bound, where they would balance the gradient spuriously.
    """
    weights = multipliers.every
    products = _products(scaled, np.append(evaluation.constraints, z), weights)
    return multipliers.kept(products <= fraction * _largest(weights))


def _products(scaled: ScaledProgram, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Size of each multiplier times the slack, at most 1, of its bound."""
    return np.abs(weights) * np.minimum(scaled.sides.slack(values, weights), 1.0)


def _largest(weights: np.ndarray) -> float:
    return float(np.abs(weights).max(initial=0.0))


def fit_multipliers(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation) -> Multipliers:
    """Find the multipliers of the active rows and bounds that minimise the norm of the Lagrangian's gradient.

    A non-negative least-squares problem (Lawson and Hanson 1974), for solvers that return no multipliers or
    outdated ones.
    """
    active, signs, _ = scaled.sides.within(np.append(evaluation.constraints, z), _ACTIVE)
    weights = np.zeros(scaled.rows + scaled.size)
    if active.size:
        # An equality appears twice, once with each sign.
        slopes = _signed(above_identity(evaluation.jacobian), active, signs)
        np.add.at(weights, active, signs * nonnegative_fit(slopes, -evaluation.gradient))
    return Multipliers(*np.split(weights, [scaled.rows]))


class Kinks(NamedTuple):
    """Rows that have a kink at a point, which opens towards their bound, as that of a spread that becomes zero.

    - `rows`: which of all, shape (k,); `normals`: by how much their slopes change across it, shape (k, n), user units;
    - `evaluation`: of the point in user units, with slopes of these rows mixed from both sides.

    Such a row is the larger one of two smooth ones. Both hold the point, so that any mixture of their slopes serves in
    the conditions of optimality: the one that fits best is taken.
    """

    rows: np.ndarray
    normals: np.ndarray
    evaluation: Evaluation


def kinks_at(scaled: ScaledProgram, z: np.ndarray) -> Kinks | None:
    """The kinks at `z` that the descent of the Lagrangian runs into; None if there are none, or rows are sparse."""
    try:
        evaluation = scaled.evaluate(z)
        if not isinstance(evaluation.jacobian, np.ndarray):
            return None
        slope = fit_multipliers(scaled, z, evaluation).slope(evaluation)
        length = _ACROSS * np.maximum(1.0, np.abs(z)) / (_largest(slope) or 1.0)
        across = np.clip(z - length * slope, scaled.lower, scaled.upper)
        beyond = scaled.evaluate(across)
    except (NotFiniteError, HaltedError):
        return None
    active, signs, _ = scaled.sides.within(np.append(evaluation.constraints, z), _ACTIVE)
    slopes, others = (_signed(above_identity(one.jacobian), active, signs) for one in (evaluation, beyond))
    first, last = slopes @ (across - z), others @ (across - z)
    bends = last - first > _BENDS * np.maximum(np.abs(first), np.abs(last))
    if not bends.any():
        return None
    fit = nonnegative_fit(np.concatenate([slopes, others[bends]]), -evaluation.gradient)
    own, other = fit[: active.size][bends], fit[active.size :]
    shares = np.divide(other, own + other, out=np.zeros_like(other), where=other > 0)
    here, there, rows = scaled.user(z), scaled.user(across), np.flatnonzero(scaled.useful)[active[bends]]
    jacobian, normals = np.array(here.jacobian), there.jacobian[rows] - here.jacobian[rows]
    jacobian[rows] += shares[:, None] * normals
    return Kinks(rows, normals, here._replace(jacobian=jacobian))


def _signed(matrix: Matrix, rows: np.ndarray, signs: np.ndarray) -> Matrix:
    """Some rows of a matrix, each times a sign."""
    if isinstance(matrix, np.ndarray):
        return signs[:, None] * matrix[rows]
    return scipy.sparse.diags_array(signs, format="csr") @ matrix[rows]


def is_least_violated(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation) -> bool:
    """Whether no step lowers the violation: its sum over the rows, or its maximum.

    Either proves that the linearised constraints have no solution near `z`: a step that meets them all would lower both
    measures. Both are linear programs in the step and the violations left, or the largest one.
    """
    rows, signs, gaps = scaled.limits.within(evaluation.constraints)
    if gaps.min(initial=0.0) >= 0:
        return False
    slopes = scipy.sparse.csr_array(_signed(evaluation.jacobian, rows, signs))
    each, largest = scipy.sparse.eye_array(rows.size), scipy.sparse.csr_array(np.ones((rows.size, 1)))
    return any(_is_stationary(scaled, z, slopes, gaps, left) for left in (largest, each))


def _is_stationary(scaled: ScaledProgram, z: np.ndarray, slopes: Matrix, gaps: np.ndarray, left: Matrix) -> bool:
    """Whether no step lowers the sum of the violations, or the largest one, by a noticeable part.

    `left`: the violations that a step may leave, each row's own or one for all, shape (rows, rows) or (rows, 1).
    """
    total = np.max if left.shape[1] == 1 else np.sum
    violation = float(total(np.maximum(-gaps, 0.0)))
    cost = np.append(np.zeros(z.size), np.ones(left.shape[1]))
    matrix = scipy.sparse.hstack([slopes / violation, -left], format="csr")

    def best_step(reach: float) -> tuple[np.ndarray, float]:
        """The step within some magnitudes of all variables and the part by which it should lower the violation."""
        lowest, highest = np.maximum(scaled.lower - z, -reach), np.minimum(scaled.upper - z, reach)
        step = np.column_stack([np.minimum(lowest, 0.0), np.maximum(highest, 0.0)])
        bounds = np.concatenate([step, np.tile([0.0, np.inf], (left.shape[1], 1))])
        # Of thousands of rows the simplex method takes minutes.
        method = "highs-ipm" if matrix.shape[0] > _MANY else "highs-ds"
        options = {"maxiter": _MOST_PIVOTS}
        found = scipy.optimize.linprog(cost, matrix, gaps / violation, bounds=bounds, method=method, options=options)
        return (found.x[: z.size], 1.0 - found.fun) if found.status == 0 else (np.zeros(z.size), np.nan)

    # Near an unstable simulation slopes are too steep for this, which proves nothing.
    if not np.isfinite(matrix.data).all() or not best_step(1.0)[1] < _STATIONARY:
        return False
    # Where a variable without a bound must go far, as a level above all rows, one typical magnitude of it is nothing.
    step, promised = best_step(_FARTHEST)
    if not promised >= _FALL:
        return not np.isnan(promised)
    for share in _SHARES:
        with contextlib.suppress(NotFiniteError):
            beyond = scaled.limits.excess(scaled.evaluate(z + share * step).constraints)
            if 1.0 - float(total(np.maximum(beyond, 0.0))) / violation >= share * promised / 2:
                return False
    return True


# --- What first-order conditions leave open ---------------------------------------------------------------------------

# Stationarity is relative to the largest term of the Lagrangian's gradient, so that a weight of 1e8 on one decision
# hides all that others could still gain; beside the curvature of a valley's walls the gradient along its floor is
# nothing; and a start on a line of symmetry is stationary across it. One look tells all of these: second derivatives
# of the Lagrangian in the directions that active rows and bounds leave free, by differences of gradients. Newton's
# step there, and one along negative curvature, are tried.

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

    - `fall`: of the objective by the quadratic model, in user units; `slope`: the largest entry of the scaled gradient;
    - `point`: one that is lower indeed, shape (n_free,); None if none of those tried is;
    - `holds`: whether all limits hold at that point;
    - `is_doubtful`: whether nothing shows the descent: differences may be rounding, or a limit stands in its way.
    """

    fall: float
    slope: float
    point: np.ndarray | None
    holds: bool
    is_doubtful: bool


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
    here = scaled.evaluate(z)
    # Those of rows and bounds close by.
    multipliers = multipliers.kept(scaled.sides.excess(np.append(here.constraints, z)) > -_NEAR)
    slope, size = multipliers.slope(here), np.maximum(1.0, np.abs(z))
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
    basis = size[:, None] * units
    objective = scaled.objective_size(here)
    least = min(_NOTICEABLE * objective, _BESIDE_START * (objective + scaled.start_objective))
    noticeable = max(least, _ROUNDING * scaled.terms(here, multipliers))
    if not unmoved.size and float(np.abs(slope @ basis).sum()) <= noticeable:
        return None
    try:
        curvature = basis.T @ scaled.curvature(z, multipliers, basis)
    except NotFiniteError:
        return None
    values, mixed = np.linalg.eigh((curvature + curvature.T) / 2)
    # Steps are measured by the variable that they move most: among thousands, a unit vector moves none.
    lengths = np.abs(units @ mixed).max(axis=0)
    directions, values = basis @ mixed / lengths, values / lengths**2
    return _tried(scaled, z, multipliers, directions, values, noticeable, is_far=unmoved.size > 0)


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


def _tried(
    scaled: ScaledProgram,
    z: np.ndarray,
    multipliers: Multipliers,
    directions: Float[np.ndarray, "n k"],
    curvatures: Float[np.ndarray, " k"],
    noticeable: float,
    *,
    is_far: bool,
) -> Descent | None:
    """The longest share of the quadratic model's step that lowers the Lagrangian, one that meets all limits if any.

    - `is_far`: whether length comes first: a solver that starts close to a saddle returns there.
    """
    here = scaled.evaluate(z)
    slope = multipliers.slope(here)
    slopes = slope @ directions
    newton, leave = _steps(curvatures, slopes, noticeable)

    def predicted(share: float) -> float:
        step = share * (np.abs(newton) + leave)
        return float((np.abs(slopes) * step - curvatures * step**2 / 2).sum())

    if predicted(1.0) <= noticeable:
        return None
    lowest, holds = None, False
    for share, sign in itertools.product(_TRIED, (1, -1) if leave.any() else (1,)):
        is_reached = lowest is not None and is_far and sign == 1
        if holds or is_reached or predicted(share) <= noticeable:
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
    is_blocked = not holds and _blocks(scaled, here, directions @ (newton + leave))
    return Descent(
        fall=predicted(1.0) * scaled.scales.objective,
        slope=float(np.abs(slope).max()),
        point=lowest,
        holds=holds,
        is_doubtful=lowest is None or is_blocked,
    )


def _blocks(scaled: ScaledProgram, here: Evaluation, step: np.ndarray) -> bool:
    """Whether a row that is at its bound stands in the way of a step."""
    rows, signs, gaps = scaled.limits.within(here.constraints)
    is_equal = scaled.constraint_lower == scaled.constraint_upper
    return bool(np.any((gaps <= _CLOSE) & (signs * (here.jacobian @ step)[rows] > 0) & ~is_equal[rows]))
