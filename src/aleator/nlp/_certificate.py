"""Optimality conditions at a point and its multipliers, computed alike for every solver, in scaled quantities."""

import contextlib
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import scipy

from aleator.nlp._evaluations import HaltedError, NotFiniteError
from aleator.nlp._matrices import Matrix, above_identity, entries, nonnegative_fit, weighted_rows
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram

# Rows and variables this close to a bound count as active when multipliers are fitted.
_ACTIVE = 1e-5
# Violations are stationary if no step of one typical magnitude of every variable lowers them by this part, and none
# that is longer, to this many magnitudes, by the other. A step is believed that brings half of what it promises, or a
# tenth of it does.
_STATIONARY, _FALL, _FARTHEST, _SHARES = 1e-3, 0.05, 1e5, (1.0, 0.1)
# A step across a kink, in magnitudes of the variables, and the least part by which a slope along it rises there.
_ACROSS, _BENDS = 1e-7, 0.1
# Steps of the simplex method after which a proof is given up; of more rows than this it would take minutes.
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
    terms = _largest(np.append(multipliers.bounds, entries(weighted_rows(multipliers.rows, evaluation.jacobian))))
    return Certificate(
        violation=float(sides.excess(values).max(initial=0.0)),
        stationarity=_largest(multipliers.slope(evaluation)) / max(1.0, terms),
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
        slopes = _slopes_of(evaluation, active, signs)
        np.add.at(weights, active, signs * nonnegative_fit(slopes, -evaluation.gradient))
    return Multipliers(*np.split(weights, [scaled.rows]))


def _slopes_of(evaluation: Evaluation, active: np.ndarray, signs: np.ndarray) -> Matrix:
    """The slopes towards the bounds of some rows and variables."""
    return weighted_rows(signs, above_identity(evaluation.jacobian)[active])


class Kinks(NamedTuple):
    """Rows that have a kink at a point, which opens towards their bound, as that of a spread that becomes zero.

    - `normals`: by how much their slopes change across it, shape (k, n), user units;
    - `evaluation`: of the point in user units, with slopes of these rows mixed from both sides.

    Such a row is the larger one of two smooth ones. Both hold the point, so that any mixture of their slopes serves in
    the conditions of optimality: the one that fits best is taken.
    """

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
    slopes, others = (_slopes_of(one, active, signs) for one in (evaluation, beyond))
    first, last = slopes @ (across - z), others @ (across - z)
    bends = last - first > _BENDS * np.maximum(np.abs(first), np.abs(last))
    if not bends.any():
        return None
    fit = nonnegative_fit(np.concatenate([slopes, others[bends]]), -evaluation.gradient)
    own, other = fit[: active.size][bends], fit[active.size :]
    shares = np.divide(other, own + other, out=np.zeros_like(other), where=other > 0)
    here, there, rows = scaled.user(z), scaled.user(across), np.flatnonzero(scaled.useful)[active[bends]]
    jacobian, normals = here.jacobian.copy(), there.jacobian[rows] - here.jacobian[rows]
    jacobian[rows] += shares[:, None] * normals
    return Kinks(normals, here._replace(jacobian=jacobian))


def is_least_violated(scaled: ScaledProgram, z: np.ndarray) -> bool:
    """Whether no step lowers the sum of the violations by a noticeable part.

    That proves that the linearised constraints have no solution near `z`, to which a step would lower the sum. It is a
    linear program in the step and the violations left.
    """
    evaluation = scaled.evaluate(z)
    rows, signs, gaps = scaled.limits.within(evaluation.constraints)
    violation = -float(gaps[gaps < 0].sum())
    slopes = scipy.sparse.csr_array(weighted_rows(signs, evaluation.jacobian[rows])) / (violation or 1.0)
    # Near an unstable simulation slopes are too steep for this, which proves nothing.
    if violation == 0 or not np.isfinite(slopes.data).all():
        return False
    matrix = scipy.sparse.hstack([slopes, -scipy.sparse.eye_array(rows.size)], format="csr")
    cost = np.append(np.zeros(z.size), np.ones(rows.size))

    def best_step(reach: float) -> tuple[np.ndarray, float]:
        """The step within some magnitudes of all variables and the part by which it should lower the violation."""
        step = np.stack([np.clip(scaled.lower - z, -reach, 0.0), np.clip(scaled.upper - z, 0.0, reach)], axis=1)
        found = scipy.optimize.linprog(
            cost,
            matrix,
            gaps / violation,
            bounds=np.concatenate([step, np.tile([0.0, np.inf], (rows.size, 1))]),
            method="highs-ipm" if rows.size > _MANY else "highs-ds",
            options={"maxiter": _MOST_PIVOTS},
        )
        return (found.x[: z.size], 1.0 - found.fun) if found.status == 0 else (np.zeros(z.size), np.nan)

    if not best_step(1.0)[1] < _STATIONARY:
        return False
    # Where a variable without a bound must go far, as a level above all rows, one typical magnitude of it is nothing.
    step, promised = best_step(_FARTHEST)
    if not promised >= _FALL:
        return not np.isnan(promised)
    for share in _SHARES:
        with contextlib.suppress(NotFiniteError):
            beyond = scaled.limits.excess(scaled.evaluate(z + share * step).constraints)
            if 1.0 - float(np.maximum(beyond, 0.0).sum()) / violation >= share * promised / 2:
                return False
    return True
