"""The distribution of an output from a large sample: values by counting, derivatives by a kernel.

The proportion of a sample beyond a threshold is a step function of its values, whose derivative is useless. The mean of
normal distribution functions centred at the values has the right derivative, if their width vanishes slowly with the
sample's size.
"""

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar
from aleator.statistics import Probability, Quantile


def probability(kind: Probability, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The proportion of the sample between the thresholds of `kind`."""
    upper = 1.0 if kind.below is None else _smooth_below(values, kind.below)
    lower = 0.0 if kind.above is None else _smooth_below(values, kind.above)
    return jax.lax.stop_gradient(kind.of_sample(values)) + _only_derivative(jnp.asarray(upper - lower))


def quantile(kind: Quantile, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The quantile of the sample, differentiated by the implicit function theorem."""
    found = jax.lax.stop_gradient(kind.of_sample(values))
    density = jax.lax.stop_gradient(pdf(values, found))
    regular = density > 0
    excess = _only_derivative(_smooth_below(values, found) - kind.level)
    return found - jnp.where(regular, excess / jnp.where(regular, density, 1.0), 0.0)


def cdf(values: Float[Array, "samples *shape"], threshold: Scalar) -> Float[Array, "*shape"]:
    """The proportion of the sample below a threshold."""
    return probability(Probability(below=threshold), values)


def pdf(values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The density at a threshold, by the kernel estimate."""
    width = _width(values)
    return jnp.mean(norm.pdf((_levels(values, threshold) - values) / width[None]), axis=0) / width


def _smooth_below(
    values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    return jnp.mean(ndtr((_levels(values, threshold) - values) / _width(values)[None]), axis=0)


def _levels(
    values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]
) -> Float[Array, "1 *shape"]:
    return jnp.broadcast_to(jnp.asarray(threshold, dtype=float), values.shape[1:])[None]


def _width(values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The width of the kernel: small compared with the spread of the sample, large compared with its gaps."""
    std = jax.lax.stop_gradient(jnp.std(values, axis=0))
    return jnp.where(std > 0, std, 1.0) * len(values) ** (-1 / 3)


def _only_derivative(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Zero, with the derivative of `value`."""
    return value - jax.lax.stop_gradient(value)
