"""Optimality conditions at a point and its multipliers, computed alike for every solver, in scaled quantities."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._matrices import (
    Matrix,
    bounded_fit,
    gradients,
    largest_term,
    nonnegative_fit,
    side_by_side,
    unit_columns,
    with_last_row,
)
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import Multipliers, ScaledProgram

# Rows this close to a bound count as active when multipliers are fitted or infeasibility is examined; in the latter
# case also no further off than this part of the largest violation, whatever the scale.
_ACTIVE, _ACTIVE_FRACTION = 1e-5, 1e-3
# A violation is stationary if one typical magnitude of every variable would lower it by less than this fraction.
_STATIONARY_FRACTION = 1e-3
# Shares of the step that should lower a violation to zero, and by which part one must lower it to count.
_SHARES, _FALL = (1.0, 0.1), 0.05
# How far such a step may go, in typical magnitudes of the variables.
_FARTHEST = 1e5


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
    values = np.concatenate([evaluation.constraints, z])
    lower = np.concatenate([scaled.constraint_lower, scaled.lower])
    upper = np.concatenate([scaled.constraint_upper, scaled.upper])

    largest = max(1.0, _largest(multipliers.rows), _largest(multipliers.bounds))
    gradient = lagrangian_gradient(evaluation, multipliers)
    # By terms, not by multipliers, which depend on the scale of the constraints.
    terms = max(1.0, _largest(multipliers.bounds), largest_term(multipliers.rows, evaluation.jacobian))
    return Certificate(
        violation=float(np.maximum(values - upper, lower - values).max(initial=0.0)),
        stationarity=float(np.abs(gradient).max(initial=0.0)) / terms,
        complementarity=max(_largest(part) for part in _products(scaled, z, evaluation, multipliers)) / largest,
    )


def complementary(
    scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, multipliers: Multipliers, fraction: float
) -> Multipliers:
    """Drop the multipliers whose product with their slack exceeds this fraction of the largest multiplier.

    An interior point leaves such residues far from any bound, where they would balance the gradient spuriously.
    """
    ceiling = fraction * max(_largest(multipliers.rows), _largest(multipliers.bounds))
    rows, bounds = _products(scaled, z, evaluation, multipliers)
    return Multipliers(
        np.where(rows <= ceiling, multipliers.rows, 0.0), np.where(bounds <= ceiling, multipliers.bounds, 0.0)
    )


def _products(
    scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, multipliers: Multipliers
) -> tuple[np.ndarray, np.ndarray]:
    """Size of each multiplier times the slack, at most 1, of its bound."""
    rows, bounds = (
        np.abs(weights) * np.minimum(np.abs(np.where(weights > 0, upper - values, values - lower)), 1.0)
        for weights, values, lower, upper in (
            (multipliers.rows, evaluation.constraints, scaled.constraint_lower, scaled.constraint_upper),
            (multipliers.bounds, z, scaled.lower, scaled.upper),
        )
    )
    return rows, bounds


def _largest(weights: np.ndarray) -> float:
    return float(np.abs(weights).max(initial=0.0))


def lagrangian_gradient(evaluation: Evaluation, multipliers: Multipliers) -> np.ndarray:
    """`∇f + Jᵀλ + μ` in scaled quantities, shape (n_free,)."""
    return evaluation.gradient + multipliers.rows @ evaluation.jacobian + multipliers.bounds


def fit_multipliers(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation) -> Multipliers:
    """Find the multipliers of the active rows and bounds that minimise the norm of the Lagrangian's gradient.

    A non-negative least-squares problem (Lawson and Hanson 1974), for solvers that return no multipliers or
    outdated ones.
    """
    rows, row_signs = _active(evaluation.constraints, scaled.constraint_lower, scaled.constraint_upper)
    bounds, bound_signs = _active(z, scaled.lower, scaled.upper)
    columns = side_by_side(
        gradients(evaluation.jacobian, rows, row_signs), unit_columns(evaluation.jacobian, bounds, bound_signs)
    )
    row_multipliers, bound_multipliers = np.zeros(scaled.rows), np.zeros(scaled.size)
    if rows.size + bounds.size:
        weights = nonnegative_fit(columns, -evaluation.gradient)
        # An equality appears twice, once with each sign.
        np.add.at(row_multipliers, rows, row_signs * weights[: rows.size])
        np.add.at(bound_multipliers, bounds, bound_signs * weights[rows.size :])
    return Multipliers(row_multipliers, bound_multipliers)


def is_least_violated(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation) -> bool:
    """Whether no step lowers the violation: its sum over the rows, or its maximum.

    Either proves that the linearised constraints have no solution near `z`: a step that meets them all would
    lower both measures.
    """
    outside = scaled.violation(evaluation.constraints)
    if outside.max(initial=0.0) <= 0:
        return False
    # Near an unstable simulation slopes are so steep that their squares overflow, which proves nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        return _sum_is_stationary(scaled, z, evaluation, outside) or _maximum_is_stationary(
            scaled, z, evaluation, outside
        )


def _sum_is_stationary(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, outside: np.ndarray) -> bool:
    """Whether zero is in the subdifferential of `Σ max(violation, 0)`.

    A row at its kink counts with any weight in [0, 1].
    """
    close = _close(outside)
    violated = outside > close
    steepest = _sides(scaled, evaluation, violated) @ evaluation.jacobian[violated]
    rows, row_signs = _active(evaluation.constraints, scaled.constraint_lower, scaled.constraint_upper, close)
    cone = _bound_cone(scaled, z, evaluation)
    columns = side_by_side(gradients(evaluation.jacobian, rows, row_signs), cone)
    remainder = steepest
    if columns.shape[1]:
        ceiling = np.concatenate([np.ones(rows.size), np.full(cone.shape[1], np.inf)])
        remainder = steepest + columns @ bounded_fit(columns, -steepest, ceiling)
    total = float(outside[violated].sum())
    if float(np.linalg.norm(remainder)) > _STATIONARY_FRACTION * total:
        return False
    return not _falls(scaled, z, remainder, total, lambda beyond: float(np.maximum(beyond, 0.0).sum()))


def _maximum_is_stationary(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation, outside: np.ndarray) -> bool:
    """Whether zero is in the subdifferential of `max violation`, the convex hull of the worst rows' gradients."""
    worst = outside >= outside.max() * (1 - _STATIONARY_FRACTION) - _close(outside)
    steep = gradients(evaluation.jacobian, np.flatnonzero(worst), _sides(scaled, evaluation, worst))
    cone = _bound_cone(scaled, z, evaluation)
    # The last equation makes the weights of the worst rows sum to one.
    sums = np.concatenate([np.ones(steep.shape[1]), np.zeros(cone.shape[1])])
    system = with_last_row(side_by_side(steep, cone), sums)
    target = np.append(np.zeros(z.size), 1.0)
    remainder = system @ nonnegative_fit(system, target) - target
    largest = float(outside.max())
    if float(np.linalg.norm(remainder)) > _STATIONARY_FRACTION * largest:
        return False
    return not _falls(scaled, z, remainder[:-1], largest, lambda beyond: float(beyond.max(initial=0.0)))


def _falls(
    scaled: ScaledProgram,
    z: np.ndarray,
    slope: np.ndarray,
    violation: float,
    measured: Callable[[np.ndarray], float],
) -> bool:
    """Whether the violation falls as a slope says that is small beside it, by steps that should lower it by much.

    Where a variable without a bound must go far, as a level above all rows, one typical magnitude of it is nothing.
    """
    steepness = float(slope @ slope)
    if not 0 < steepness < np.inf:
        return False
    for share in _SHARES:
        moved = np.clip(z - share * violation / steepness * slope, scaled.lower, scaled.upper)
        promised = float(slope @ (z - moved))
        # Further out, another scale of the variables is needed, which other starts have.
        if not np.abs(moved - z).max() < _FARTHEST or promised < _FALL * violation:
            return False
        with contextlib.suppress(NotFiniteError):
            beyond = scaled.violation(scaled.evaluate(moved).constraints)
            if violation - measured(beyond) >= promised / 2:
                return True
    return False


def _close(outside: np.ndarray) -> float:
    """How close to a bound a row is active where others are violated by `outside`."""
    return min(_ACTIVE, _ACTIVE_FRACTION * float(outside.max()))


def _sides(scaled: ScaledProgram, evaluation: Evaluation, rows: np.ndarray) -> np.ndarray:
    """+1 for rows above their range and -1 for rows below it."""
    middle_excess = evaluation.constraints - scaled.constraint_upper
    return np.where(middle_excess >= scaled.constraint_lower - evaluation.constraints, 1.0, -1.0)[rows]


def _bound_cone(scaled: ScaledProgram, z: np.ndarray, evaluation: Evaluation) -> Matrix:
    """Outward unit normals of the active bounds of the variables, as columns."""
    return unit_columns(evaluation.jacobian, *_active(z, scaled.lower, scaled.upper))


def _active(
    values: np.ndarray, lower: np.ndarray, upper: np.ndarray, close: float = _ACTIVE
) -> tuple[np.ndarray, np.ndarray]:
    """Find the values at a bound, with the sign of its multiplier; an equality is at both."""
    at_upper = np.flatnonzero(np.abs(upper - values) <= close)
    at_lower = np.flatnonzero(np.abs(values - lower) <= close)
    return np.concatenate([at_upper, at_lower]), np.concatenate([np.ones(at_upper.size), -np.ones(at_lower.size)])
