"""All real roots of many polynomials at once, on the interval from -1 to 1.

Between neighbouring extrema a polynomial is monotone and has at most one root, which bisection cannot miss. The extrema
are the roots of the derivative, found in the same way from those of the second derivative, and so on. Unlike a search
on a grid, this misses none.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

# Newton's method within a bracket, bisection where a step leaves it: exact to rounding for simple roots.
_ITERATIONS = 14
# At a root, rounding may put a value and a step on different sides. A step that leaves the bracket by less than this
# part of it, or by rounding, ends at its edge: bisection would lose the digits found so far.
_AT_THE_EDGE, _ROUNDING = 1e-6, 1e-14


def extrema(powers: Float[Array, "orders *lines"]) -> Float[Array, "edges *lines"]:
    """The edges between which each polynomial is monotone: -1, its extrema, 1.

    Polynomials are given by their coefficients of `x^0, x^1, ...`. If one has fewer extrema, edges coincide.
    """
    degree = len(powers) - 1
    end = jnp.ones((1, *powers.shape[1:]))
    edges = jnp.concatenate([-end, end])
    for order in range(degree - 1, 0, -1):
        inner, _ = bracketed_roots(_derivative(powers, order), edges)
        edges = jnp.concatenate([-end, inner, end])
    return edges


def bracketed_roots(
    powers: Float[Array, "orders *lines"], edges: Float[Array, "edges *lines"]
) -> tuple[Float[Array, "intervals *lines"], Bool[Array, "intervals *lines"]]:
    """The root between each pair of neighbouring edges, and whether the polynomial rises there.

    Where there is no root, it is the edge at which the value is nearest to zero.
    """
    low, high = edges[:-1], edges[1:]
    at_low, at_high = horner(powers, low), horner(powers, high)
    rising = at_high >= at_low

    def narrow(_: int, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, x = state
        value, slope = _with_slope(powers, x)
        below = (value < 0) == rising
        low, high = jnp.where(below, x, low), jnp.where(below, high, x)
        newton = x - value / jnp.where(slope == 0, 1.0, slope)
        edge = _AT_THE_EDGE * (high - low) + _ROUNDING
        usable = (newton >= low - edge) & (newton <= high + edge) & (slope != 0)
        return low, high, jnp.where(usable, jnp.clip(newton, low, high), (low + high) / 2)

    root = jax.lax.fori_loop(0, _ITERATIONS, narrow, (low, high, (low + high) / 2))[2]
    ends_below = jnp.where(rising, at_high, at_low) <= 0
    ends_above = jnp.where(rising, at_low, at_high) >= 0
    root = jnp.where(ends_below, jnp.where(rising, high, low), root)
    return jnp.where(ends_above & ~ends_below, jnp.where(rising, low, high), root), rising


def horner(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> Float[Array, "points *lines"]:
    """The values of polynomials, each at its own points."""
    value = jnp.zeros(x.shape)
    for coefficient in powers[::-1]:
        value = value * x + coefficient[None]
    return value


def slope(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> Float[Array, "points *lines"]:
    """The first derivatives of polynomials, each at its own points."""
    return _with_slope(powers, x)[1]


def _with_slope(powers: Array, x: Array) -> tuple[Array, Array]:
    value, slope = jnp.zeros(x.shape), jnp.zeros(x.shape)
    for coefficient in powers[::-1]:
        slope = slope * x + value
        value = value * x + coefficient[None]
    return value, slope


def _derivative(powers: Float[Array, "orders *lines"], order: int) -> Float[Array, "fewer *lines"]:
    """The coefficients of a derivative, up to a common factor."""
    exponents = np.arange(order, len(powers))
    factors = np.ones(len(exponents))
    for step in range(order):
        factors *= (exponents - step) / (order - step)
    return powers[order:] * jnp.asarray(factors).reshape(-1, *[1] * (powers.ndim - 1))
