"""Quantiles that are differentiable in the shape parameters of a distribution, by the implicit function theorem.

Differentiating `F(x; s) = u` at a fixed level `u` gives `dx/ds = -(dF/ds) / f` with the density `f`: exact, and
independent of how the root was found. This serves shape parameters that are decisions: the germ keeps the initial
shape, so that the collocation matrix stays constant, and its values are transported to the distribution of the current
shape. The rules are themselves differentiable, so that second derivatives are exact too. A level is given as both the
probability below and the probability above, so that each tail keeps its accuracy.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jaxtyping import Array, Bool, Int

from aleator._core.arrays import Scalar

_BISECTIONS = 70


def tanh_sinh(nodes: int = 111, first: float = -6.0, last: float = 3.4) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on (0, 1) for integrands with singular end points (Takahasi and Mori, 1974).

    They start at 1e-275, so that no mass is lost where a small shape parameter makes the density almost non-integrable
    at 0, and end one rounding error before 1, where the integrands are smooth.
    """
    t = np.linspace(first, last, nodes)
    u = np.pi * np.sinh(t)
    return 1 / (1 + np.exp(-u)), (t[1] - t[0]) * np.pi * np.cosh(t) / (4 * np.cosh(u / 2) ** 2)


def _exp_exp(nodes: int = 111, first: float = -3.8, last: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on (0, inf) for integrands that decay exponentially (Takahasi and Mori, 1974)."""
    t = np.linspace(first, last, nodes)
    x = np.exp(t - np.exp(-t))
    return x, (t[1] - t[0]) * x * (1 + np.exp(-t))


_NODES, _WEIGHTS = tanh_sinh()
_TAIL_NODES, _TAIL_WEIGHTS = _exp_exp()


def bisect(is_below: Callable[[Array], Bool[Array, ""]], like: Array) -> Array:
    """The point of (0, 1) where `is_below` changes from true to false."""

    def halve(_: Int[Array, ""], bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) / 2
        below = is_below(middle)
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (jnp.zeros_like(like), jnp.ones_like(like)))
    return (low + high) / 2


def _differentiable(
    solve: Callable[..., Array],
    density: Callable[..., Array],
    by_shape: Callable[..., tuple[Array, ...]],
) -> tuple[Callable[..., Array], Callable[..., Array]]:
    """The quantile `(below, above, *shape)` and the anchor `(x, *shape)` of a distribution, with implicit derivatives.

    The anchor is the identity in `x`, with the derivative of a value that moves at equal probability as the shape
    varies. It serves germ values whose shape is differentiated but not decided, and costs nothing where no derivative
    is taken.
    """

    @jax.custom_jvp
    def quantile(below: Array, above: Array, *shape: Array) -> Array:
        return solve(below, above, *shape)

    @quantile.defjvp
    def _quantile_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
        below, above, *shape = primals
        below_dot, above_dot, *shape_dot = tangents
        x = quantile(below, above, *shape)
        level_dot = jnp.where(below < above, below_dot, -above_dot)
        inside = (below > 0) & (above > 0)
        # The ends of the support do not move with the shape.
        slope = (level_dot - _along(x, shape, shape_dot)) / jnp.where(inside, density(x, *shape), 1.0)
        return x, jnp.where(inside, slope, 0.0)

    @jax.custom_jvp
    def anchor(x: Array, *shape: Array) -> Array:
        del shape
        return jnp.asarray(x)

    @anchor.defjvp
    def _anchor_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
        source, *shape = primals
        source_dot, *shape_dot = tangents
        x = anchor(source, *shape)
        level_dot = density(source, *jax.lax.stop_gradient(shape)) * source_dot
        return x, (level_dot - _along(x, shape, shape_dot)) / density(x, *shape)

    def _along(x: Array, shape: list, shape_dot: list) -> Array:
        return sum((by * dot for by, dot in zip(by_shape(x, *shape), shape_dot, strict=True)), jnp.zeros_like(x))

    return quantile, anchor


@jax.jit  # compiled once, even when called eagerly
def _beta_root(below: Array, above: Array, alpha: Scalar, beta: Scalar) -> Array:
    left = below < above
    level = jnp.where(left, below, above)
    first, second = jnp.where(left, alpha, beta), jnp.where(left, beta, alpha)
    distance = bisect(lambda x: special.betainc(first, second, x) < level, level)
    return jnp.where(left, distance, 1 - distance)


def _beta_log_density(x: Array, complement: Array, alpha: Scalar, beta: Scalar) -> Array:
    return jnp.asarray((alpha - 1) * jnp.log(x) + (beta - 1) * jnp.log(complement) - special.betaln(alpha, beta))


def _beta_density(x: Array, alpha: Scalar, beta: Scalar) -> Array:
    return jnp.exp(_beta_log_density(x, 1 - x, alpha, beta))


def _beta_by_shape(x: Array, alpha: Scalar, beta: Scalar) -> tuple[Array, Array]:
    """Derivatives of the incomplete beta function by its shapes, by quadrature on the side of `x` with less mass.

    `dF/d alpha = integral over (0, x) of (ln t - digamma(alpha) + digamma(alpha + beta)) f(t)`, and the same integral
    over (x, 1) is its negative, since the two add up to the derivative of 1.
    """
    left = x < alpha / (alpha + beta)
    length = jnp.where(left, x, 1 - x)
    t, complement = (
        jnp.where(left, length * _NODES, 1 - length * _NODES),
        jnp.where(left, 1 - length * _NODES, length * _NODES),
    )
    mass = jnp.exp(_beta_log_density(t, complement, alpha, beta)) * _WEIGHTS * jnp.where(left, length, -length)
    both = special.digamma(alpha + beta)
    by_alpha = jnp.sum((jnp.log(t) - special.digamma(alpha) + both) * mass)
    by_beta = jnp.sum((jnp.log(complement) - special.digamma(beta) + both) * mass)
    return by_alpha, by_beta


@jax.jit
def _gamma_root(below: Array, above: Array, shape: Scalar) -> Array:
    left = below < above

    def is_below(y: Array) -> Bool[Array, ""]:
        x = y / (1 - y)  # maps the half-line to (0, 1)
        return jnp.where(left, special.gammainc(shape, x) < below, special.gammaincc(shape, x) > above)

    fraction = bisect(is_below, below)
    return fraction / (1 - fraction)


def _gamma_density(x: Array, shape: Scalar) -> Array:
    return jnp.exp((shape - 1) * jnp.log(x) - x - special.gammaln(shape))


def _gamma_by_shape(x: Array, shape: Scalar) -> tuple[Array]:
    """Derivative of the incomplete gamma function by its shape, by quadrature on the side of `x` with less mass.

    `dF/d shape = integral over (0, x) of (ln t - digamma(shape)) f(t)`; the integral over (x, inf) is its negative.
    """
    left = x < shape
    width = 1 + jnp.sqrt(shape)  # of the density's bulk, beyond which no mass remains
    length = jnp.minimum(x, 12 * width)
    t = jnp.where(left, x - length + length * _NODES, x + width * _TAIL_NODES)
    weights = jnp.where(left, length * _WEIGHTS, -width * _TAIL_WEIGHTS)
    return (jnp.sum((jnp.log(t) - special.digamma(shape)) * _gamma_density(t, shape) * weights),)


beta_quantile, beta_anchor = _differentiable(_beta_root, _beta_density, _beta_by_shape)
gamma_quantile, gamma_anchor = _differentiable(_gamma_root, _gamma_density, _gamma_by_shape)
