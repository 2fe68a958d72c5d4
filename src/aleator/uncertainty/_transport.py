"""Quantiles that are differentiable in the shape parameters of a law, by the implicit function theorem.

Differentiating `F(x; s) = u` at a fixed level `u` gives `dx/ds = -(dF/ds) / f` with the density `f`: exact, and
independent of how the root was found. Used when a shape parameter is a decision: the germ stays that of the initial
shape, so that the collocation matrix stays constant, and its values are transported to the law of the current shape.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jaxtyping import Array, Float, Int

from aleator._core.arrays import Scalar

_BISECTIONS = 70


def _tanh_sinh(nodes: int = 111, first: float = -6.0, last: float = 3.4) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on (0, 1) that stand singular end points (Takahasi and Mori, 1974).

    They start at 1e-275, so that nothing is cut off where a small shape parameter makes the density nearly
    not integrable at 0, and end one rounding error before 1, where the integrands are smooth.
    """
    t = np.linspace(first, last, nodes)
    u = np.pi * np.sinh(t)
    return 1 / (1 + np.exp(-u)), (t[1] - t[0]) * np.pi * np.cosh(t) / (4 * np.cosh(u / 2) ** 2)


_NODES, _WEIGHTS = _tanh_sinh()


def _bisect(cumulative: Callable[[Array], Array], level: Array) -> Array:
    """Root of `cumulative(x) = level` on (0, 1)."""

    def halve(_: Int[Array, ""], bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) / 2
        below = cumulative(middle) < level
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (jnp.zeros_like(level), jnp.ones_like(level)))
    return (low + high) / 2


@jax.custom_jvp
def beta_quantile(level: Float[Array, ""], alpha: Scalar, beta: Scalar) -> Float[Array, ""]:
    """Quantile on (0, 1) of the Beta law, differentiable in all three arguments."""
    return _bisect(lambda x: special.betainc(alpha, beta, x), level)


@beta_quantile.defjvp
def _beta_quantile_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    level, alpha, beta = primals
    level_dot, alpha_dot, beta_dot = tangents
    x = beta_quantile(level, alpha, beta)
    by_alpha, by_beta = _beta_cumulative_derivatives(x, alpha, beta)
    density = jnp.exp(_beta_log_density(x, 1 - x, alpha, beta))
    return x, (level_dot - by_alpha * alpha_dot - by_beta * beta_dot) / density


def _beta_log_density(x: Array, complement: Array, alpha: Scalar, beta: Scalar) -> Array:
    return jnp.asarray((alpha - 1) * jnp.log(x) + (beta - 1) * jnp.log(complement) - special.betaln(alpha, beta))


def _beta_cumulative_derivatives(x: Array, alpha: Scalar, beta: Scalar) -> tuple[Array, Array]:
    """Derivatives of the incomplete beta function in its shapes, by quadrature on the side of `x` with less mass.

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


@jax.custom_jvp
def gamma_quantile(level: Float[Array, ""], shape: Scalar) -> Float[Array, ""]:
    """Quantile of the Gamma law with unit scale, differentiable in both arguments."""
    # x / (1 + x) brings the half line to (0, 1).
    fraction = _bisect(lambda y: special.gammainc(shape, y / (1 - y)), level)
    return fraction / (1 - fraction)


@gamma_quantile.defjvp
def _gamma_quantile_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    level, shape = primals
    level_dot, shape_dot = tangents
    x = gamma_quantile(level, shape)
    by_shape = jax.grad(special.gammainc)(shape, x)
    density = jnp.exp((shape - 1) * jnp.log(x) - x - special.gammaln(shape))
    return x, (level_dot - by_shape * shape_dot) / density
