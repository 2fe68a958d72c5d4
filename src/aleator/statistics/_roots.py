"""Values and roots of many polynomials at once, given by their coefficients of `x^0, x^1, ...`."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# Newton's method within a bracket, bisection where a step leaves it. It ends when the last root moves by no more than
# this, after which the error of a simple root, which a step squares, is rounding.
_MOST_ITERATIONS, _AT_REST = 30, 1e-9
# At a root, rounding may put a value and a step on different sides. A step that leaves the bracket by less than this
# part of it, or by rounding, ends at its edge: bisection would lose the digits found so far.
_AT_THE_EDGE, _ROUNDING = 1e-6, 1e-14


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
