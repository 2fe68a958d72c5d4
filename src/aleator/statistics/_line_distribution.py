"""The distribution of one germ variable as a function for JAX: probabilities and partial moments, from tables.

A germ has its distribution function in NumPy only. Here it is tabulated on an interval, `x` from -1 to 1, together
with the partial moments `G_k(x)`, the integrals of the orthonormal polynomials `p_k` over the probability up to `x`
(`G_0` is the distribution function). Tables are cubic splines in the fourth root of the distance from the nearer end,
in which distributions with a singular density at an end (Beta, Gamma) are smooth. Their error is below 1e-9.
"""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.module import Module
from aleator.uncertainty import AbstractGerm

_CELLS = 2048
_POWER = 4  # two square roots, see `LineDistribution`

# Unbounded distributions are cut where double precision cannot tell the distribution function from 0 or 1.
_LEAST_LEVEL = 2.0**-53

# Keeps the derivative of the root finite at the ends, where it is not used.
_LEAST_DISTANCE = 1e-60


@final
class LineDistribution(Module):
    """The distributions of several variables, each scaled to [-1, 1], with `orders` polynomials of each.

    - `table`: of the partial moments, shape (variables, 2 ends, cells, 4, orders);
    - `monomials[v, k, m]`: the coefficient of `x^m` in `p_k`;
    - `from_powers[v, m, k]`: powers of the germ variable itself as sums of `p_k`.
    """

    table: Float[Array, "variables 2 cells 4 orders"]
    monomials: Float[Array, "variables orders orders"]
    from_powers: Float[Array, "variables orders orders"]

    def partial_moments(self, x: Float[Array, "*points variables lines"], orders: int) -> Float[Array, "..."]:
        """`G_k(x)` for the first `orders` polynomials, along a new last axis. Not differentiable."""
        cubic, within, _ = self._spline(x, orders)
        return _value(jnp.moveaxis(cubic, -2, 0), within[..., None])

    def level_and_density(self, x: Float[Array, "*points variables lines"]) -> tuple[Array, Array]:
        """The distribution function, and the probability density with respect to the scaled variable `x`."""
        cubic, within, root = self._spline(x, 1)
        cubic = jnp.moveaxis(cubic[..., 0], -1, 0)
        by_root = (3 * cubic[0] * within + 2 * cubic[1]) * within + cubic[2]
        density = -jnp.where(x > 0, 1.0, -1.0) * by_root * _CELLS / (_POWER * root ** (_POWER - 1))
        return _value(cubic, within), density

    def _spline(self, x: Array, orders: int) -> tuple[Array, Array, Array]:
        """For each point: the cubic's coefficients in its cell, its place in the cell, and the root of its distance."""
        root = jnp.sqrt(jnp.sqrt(jnp.maximum(1 - jnp.abs(x), _LEAST_DISTANCE)))
        cell = jnp.clip((root * _CELLS).astype(int), 0, _CELLS - 1)
        variable = jax.lax.broadcasted_iota(int, x.shape, x.ndim - 2)
        return self.table[variable, (x > 0).astype(int), cell, :, :orders], root * _CELLS - cell, root


def _value(cubic: Float[Array, "4 ..."], within: Array) -> Array:
    return ((cubic[0] * within + cubic[1]) * within + cubic[2]) * within + cubic[3]


def line_distribution(germs: list[AbstractGerm], orders: int) -> LineDistribution:
    """Tabulate the distributions of some germ variables."""
    ends = [finite_ends(germ) for germ in germs]
    both = list(zip(germs, ends, strict=True))
    monomials = [_monomials(germ, *end, orders) for germ, end in both]
    powers = [np.linalg.inv(_monomials(germ, -1.0, 1.0, orders)) for germ in germs]
    table = [_table(germ, *end, orders) for germ, end in both]
    return LineDistribution(*(jax_array(np.stack(one)) for one in (table, monomials, powers)))


def finite_ends(germ: AbstractGerm) -> tuple[float, float]:
    """The support of a germ; an unbounded one is cut at a level of 1e-16."""
    low, high = germ.support()
    if np.isinf(low):
        low = float(germ.quantile(np.array(_LEAST_LEVEL)))
    if np.isinf(high):
        high = float(germ.quantile(np.array(1 - _LEAST_LEVEL)))
    return low, high


def _monomials(germ: AbstractGerm, low: float, high: float, orders: int) -> Float[np.ndarray, "orders orders"]:
    """The coefficients of the orthonormal polynomials by powers of `x`, where `low` is -1 and `high` is 1."""
    a, b = germ.recurrence(orders)
    middle, half = (low + high) / 2, (high - low) / 2
    rows = np.zeros((orders + 1, orders))
    rows[0, 0] = 1.0
    for n in range(orders - 1):
        times_x = np.concatenate([[0.0], rows[n, :-1]])
        rows[n + 1] = (half * times_x + (middle - a[n]) * rows[n] - b[n] * rows[n - 1]) / b[n + 1]
    return rows[:orders]


def _table(germ: AbstractGerm, low: float, high: float, orders: int) -> Float[np.ndarray, "2 cells 4 orders"]:
    """Splines of the partial moments from either end to the middle, by the root of the distance from that end.

    By parts, `G_k = p_k F - integral of F p_k'` for the distribution function `F`, and so for `1 - F` from above. The
    integral is taken by Gauss quadrature in each cell.
    """
    roots = np.linspace(0.0, 1.0, _CELLS + 1)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inner = (roots[:-1, None] + (nodes + 1) / (2 * _CELLS)).ravel()
    half = (high - low) / 2
    splines = []
    for end, sign in ((low, 1.0), (high, -1.0)):
        at, between = (end + sign * half * root**_POWER for root in (roots, inner))
        steps = half * _POWER * inner ** (_POWER - 1) * np.tile(weights, _CELLS) / (2 * _CELLS)
        beyond = _beyond(germ, at, sign)[:, None] * _with_slopes(germ, at, orders)[0]
        parts = (steps * _beyond(germ, between, sign))[:, None] * _with_slopes(germ, between, orders)[1]
        sums = np.concatenate([np.zeros((1, orders)), parts.reshape(_CELLS, 4, orders).sum(axis=1).cumsum(axis=0)])
        moments = beyond - sign * sums
        total = (np.arange(orders) == 0).astype(float)
        values = moments if sign > 0 else total - moments
        # The unit of length is a cell, not the whole interval.
        scale = float(_CELLS) ** -np.arange(3, -1, -1)
        splines.append(np.moveaxis(scipy.interpolate.CubicSpline(roots, values).c * scale[:, None, None], 0, 1))
    return np.stack(splines)


def _beyond(germ: AbstractGerm, at: Float[np.ndarray, " n"], sign: float) -> Float[np.ndarray, " n"]:
    """The probability between an end of the support and some germ values."""
    level = germ.cumulative(at)
    return level if sign > 0 else 1 - level


def _with_slopes(germ: AbstractGerm, at: Float[np.ndarray, " n"], orders: int) -> tuple[np.ndarray, np.ndarray]:
    """The orthonormal polynomials and their derivatives, each of shape (n, orders)."""
    a, b = germ.recurrence(orders)
    values = germ.polynomials(orders - 1, at)
    slopes = np.zeros(values.shape)
    for n in range(orders - 1):
        slopes[:, n + 1] = (values[:, n] + (at - a[n]) * slopes[:, n] - b[n] * slopes[:, n - 1]) / b[n + 1]
    return values, slopes
