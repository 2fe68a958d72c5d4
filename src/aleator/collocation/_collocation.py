"""Least-squares collocation: from samples at germ points to the coefficients of the expansion (section 4.2).

The collocation matrix depends on the germ alone, so it is built and factorised once per problem; what the optimiser
changes are the samples.
"""

from math import comb
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.errors import ProblemError
from aleator.collocation._index_set import total_degree
from aleator.collocation._points import hammersley
from aleator.uncertainty import AbstractGerm

# Beyond this, least squares loses more than half of the digits of double precision.
_WORST_CONDITION = 1e8

# What is left of one minus the leverage by rounding, where it is zero in exact arithmetic.
_LEAST_REMAINDER = 1e-8

# Outputs that vary by less than this part of their size are constant, but for rounding.
_ROUNDING = 1e-12


@final
class Expansion(eqx.Module):
    """How outputs are expanded: all products of orthonormal polynomials up to total degree `order`.

    Their coefficients are found by least squares at `points` Hammersley points, by default three for each term, as the
    dissertation advises after equation (29).
    """

    order: int = eqx.field(static=True)
    points: int | None = eqx.field(static=True)

    def __init__(self, order: int = 3, *, points: int | None = None):
        if isinstance(order, bool) or not isinstance(order, int) or order < 1:
            raise ProblemError(f"Expansion: the order is a whole number of at least 1; received {order!r}.")
        if points is not None and (isinstance(points, bool) or not isinstance(points, int) or points < 1):
            raise ProblemError(f"Expansion: points is a positive whole number; received {points!r}.")
        self.order = order
        self.points = points

    def terms(self, variables: int) -> int:
        """The number of basis terms `n_b` for as many uncertain variables."""
        return comb(variables + self.order, variables)

    def point_count(self, variables: int) -> int:
        """The number of collocation points `n_cp` for as many uncertain variables: one if nothing is uncertain."""
        if variables == 0:
            return 1
        return self.points if self.points is not None else 3 * self.terms(variables)


@final
class Collocation(eqx.Module):
    """Collocation points and the least-squares map from samples to coefficients.

    - `points`: germ values, shape (n_cp, variables);
    - `matrix`: the collocation matrix `A` (28), shape (n_cp, n_b);
    - `indices`: degree of each variable in each term, shape (n_b, variables);
    - `pseudo_inverse`: `A#` of equation (29), shape (n_b, n_cp), from the QR factors of the collocation matrix (28);
    - `leverage`: diagonal of `A A#`, shape (n_cp,), for the leave-one-out error;
    - `condition_number` of the collocation matrix.
    """

    points: Float[Array, "points variables"]
    matrix: Float[Array, "points terms"]
    pseudo_inverse: Float[Array, "terms points"]
    leverage: Float[Array, " points"]
    indices: Int[Array, "terms variables"]
    condition_number: Float[Array, ""]

    def coefficients(self, samples: Float[Array, "points *shape"]) -> Float[Array, "terms *shape"]:
        """Coefficients `rho = A# P` of samples of any shape, for instance time histories (equations 29 and 47)."""
        return jnp.tensordot(self.pseudo_inverse, samples, axes=1)


def collocate(germs: tuple[AbstractGerm, ...], expansion: Expansion) -> Collocation:
    """Choose the points and factorise the collocation matrix for a germ.

    Raises `ProblemError` if there are fewer points than terms or if the matrix is singular to working precision.
    """
    variables = len(germs)
    count, terms = expansion.point_count(variables), expansion.terms(variables)
    if count < terms:
        raise ProblemError(
            f"Expansion: order {expansion.order} in {variables} variables has {terms} terms and needs at least as many "
            f"points; received {count}. Use 3 * {terms} = {3 * terms} points or a lower order."
        )
    points = _map_to_germ(germs, hammersley(count, variables))
    indices = total_degree(variables, expansion.order)
    matrix = collocation_matrix(germs, indices, points)
    orthogonal, triangular = np.linalg.qr(matrix)
    condition = float(np.linalg.cond(triangular))
    if not condition < _WORST_CONDITION:
        raise ProblemError(
            f"The collocation matrix of {count} points and {terms} terms has condition number {condition:.1e}, too "
            f"large for least squares (limit {_WORST_CONDITION:.0e}). Use more points or a lower order."
        )
    return Collocation(
        points=jnp.asarray(points),
        matrix=jnp.asarray(matrix),
        pseudo_inverse=jnp.asarray(np.linalg.solve(triangular, orthogonal.T)),
        leverage=jnp.asarray(np.sum(orthogonal**2, axis=1)),
        indices=jnp.asarray(indices),
        condition_number=jnp.asarray(condition),
    )


def _map_to_germ(germs: tuple[AbstractGerm, ...], levels: np.ndarray) -> Float[np.ndarray, "points variables"]:
    columns = [germ.quantile(levels[:, i]) for i, germ in enumerate(germs)]
    return np.stack(columns, axis=1) if columns else levels


def collocation_matrix(
    germs: tuple[AbstractGerm, ...],
    indices: Int[np.ndarray, "terms variables"],
    points: Float[np.ndarray, "n variables"],
) -> Float[np.ndarray, "n terms"]:
    """The matrix `A[k, j] = Psi_j(xi_k)` of equation (28), in the orthonormal basis."""
    matrix = np.ones((len(points), len(indices)))
    for i, germ in enumerate(germs):
        matrix *= germ.polynomials(int(indices[:, i].max()), points[:, i])[:, indices[:, i]]
    return matrix


def leave_one_out(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """Relative leave-one-out error of an expansion: squared prediction error over variance, both summed over entries.

    Each sample is predicted from all others at no further cost, by the leverage (Blatman and Sudret, 2010). 0 is
    perfect; 1 is no better than the mean. Zero where the output does not vary beyond rounding. Infinite where a sample
    cannot be predicted, its leverage being one: as many points as terms, for instance, only interpolate.
    """
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    residual = flat - collocation.matrix @ terms
    remainder = 1 - collocation.leverage
    predictable = remainder > _LEAST_REMAINDER
    error = jnp.mean((residual / jnp.where(predictable, remainder, 1.0)[:, None]) ** 2, axis=0).sum()
    error = jnp.where(predictable.all(), error, jnp.inf)
    variance = flat.var(axis=0).sum()
    # Asked this way round, samples that are not finite leave a nan and do not pass for constant.
    constant = variance <= _ROUNDING**2 * jnp.mean(flat**2, axis=0).sum()
    return jnp.where(constant, 0.0, error / jnp.where(constant, 1.0, variance))
