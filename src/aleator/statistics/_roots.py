"""Roots of many polynomials at once, between the edges of intervals on which each is monotone."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

# Newton's method within a bracket, bisection where a step leaves it. It ends when the last root moves by no more than
# this, after which the error of a simple root, which a step squares, is rounding.
_MOST_ITERATIONS, _AT_REST = 30, 1e-9
# At a root, rounding may put a value and a step on different sides. A step that leaves the bracket by less than this
# part of it, or by rounding, ends at its edge: bisection would lose the digits found so far.
_AT_THE_EDGE, _ROUNDING = 1e-6, 1e-14


def extrema(powers: Float[Array, "orders *lines"]) -> Float[Array, "edges *lines"]:
    """The edges between which each polynomial is monotone: -1, its extrema, 1.

    The extrema are the roots of the derivative, found in the same way from those of the second derivative, and so on,
    down to a quadratic one. Between neighbouring edges a polynomial has at most one root, which bisection cannot miss:
    unlike a search on a grid, this misses none.

    Polynomials are given by their coefficients of `x^0, x^1, ...`. If one has fewer extrema, edges coincide.
    """
    degree = len(powers) - 1
    end = jnp.ones((1, *powers.shape[1:]))
    inner = _lowest(_derivative(powers, max(degree - 2, 1))) if degree > 1 else end[:0]
    edges = jnp.concatenate([-end, inner, end])
    for order in range(degree - 3, 0, -1):
        slopes = _derivative(powers, order)
        edges = jnp.concatenate([-end, roots_between(slopes, edges, horner(slopes, edges)), end])
    return edges


def _lowest(powers: Float[Array, "orders *lines"]) -> Float[Array, "roots *lines"]:
    """The roots of polynomials of degree one or two in rising order: 1 for those that are not real, none beyond ±1."""
    constant, linear = powers[:2]
    if len(powers) == 2:
        return jnp.clip(_ratio(-constant, linear), -1.0, 1.0)[None]
    # One of the two by its sum with the other would lose digits.
    radicand = linear**2 - 4 * powers[2] * constant
    half = -(linear + jnp.where(linear < 0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(radicand, 0.0))) / 2
    first, second = (
        jnp.where(radicand < 0, 1.0, jnp.clip(root, -1.0, 1.0))
        for root in (_ratio(half, powers[2]), _ratio(constant, half))
    )
    return jnp.stack([jnp.minimum(first, second), jnp.maximum(first, second)])


def _ratio(above: Array, below: Array) -> Array:
    return jnp.where(below == 0, 1.0, above / jnp.where(below == 0, 1.0, below))


def roots_between(
    powers: Float[Array, "orders *lines"],
    edges: Float[Array, "edges *lines"],
    values: Float[Array, "edges *lines"],
) -> Float[Array, "intervals *lines"]:
    """The root between each pair of neighbouring edges, at which the polynomials have known values.

    Where there is no root, it is the edge at which the value is nearest to zero. The search begins where straight lines
    between the edges have their roots.
    """
    low, high = edges[:-1], edges[1:]
    rising = values[1:] >= values[:-1]
    is_below = jnp.maximum(values[:-1], values[1:]) <= 0
    is_above = (jnp.minimum(values[:-1], values[1:]) >= 0) & ~is_below
    # A bracket without a root is empty.
    at_low, at_high = jnp.where(rising, is_above, is_below), jnp.where(rising, is_below, is_above)
    low, high = jnp.where(at_high, high, low), jnp.where(at_low, low, high)

    return root_within(powers, low, high, rising, jnp.clip(_secants(edges, values), low, high))


def root_within(
    powers: Float[Array, "orders *lines"],
    low: Float[Array, "points *lines"],
    high: Float[Array, "points *lines"],
    rising: Bool[Array, "points *lines"],
    start: Float[Array, "points *lines"],
) -> Float[Array, "points *lines"]:
    """The root of each polynomial between two places, from one to the other of which its sign changes."""

    def is_moving(state: tuple[Array, ...]) -> Bool[Array, ""]:
        *_, moving, count = state
        return moving & (count < _MOST_ITERATIONS)

    def narrow(state: tuple[Array, ...]) -> tuple[Array, ...]:
        low, high, x, _, count = state
        value, slope = with_slope(powers, x)
        below = (value < 0) == rising
        low, high = jnp.where(below, x, low), jnp.where(below, high, x)
        newton = x - value / jnp.where(slope == 0, 1.0, slope)
        edge = _AT_THE_EDGE * (high - low) + _ROUNDING
        usable = (newton >= low - edge) & (newton <= high + edge) & (slope != 0)
        closer = jnp.where(usable, jnp.clip(newton, low, high), (low + high) / 2)
        return low, high, closer, jnp.any(jnp.abs(closer - x) > _AT_REST), count + 1

    return jax.lax.while_loop(is_moving, narrow, (low, high, start, jnp.array(True), jnp.zeros((), int)))[2]


def _secants(
    edges: Float[Array, "edges *lines"], values: Float[Array, "edges *lines"]
) -> Float[Array, "intervals *lines"]:
    """The roots of the straight lines between neighbouring edges, at which polynomials have some values."""
    rise = values[1:] - values[:-1]
    return edges[:-1] - values[:-1] * (edges[1:] - edges[:-1]) / jnp.where(rise == 0, 1.0, rise)


def horner(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> Float[Array, "points *lines"]:
    """The values of polynomials, each at its own points."""
    value = jnp.broadcast_to(powers[-1][None], x.shape)
    for coefficient in powers[-2::-1]:
        value = value * x + coefficient[None]
    return value


def with_slope(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> tuple[Array, Array]:
    """The values and first derivatives of polynomials, each at its own points."""
    value, slope = jnp.broadcast_to(powers[-1][None], x.shape), jnp.zeros(x.shape)
    for coefficient in powers[-2::-1]:
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
