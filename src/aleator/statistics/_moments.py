"""Moments of an expansion in an orthonormal basis, from its coefficients alone (equations 30-33, 98, 99)."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def mean(coefficients: Float[Array, "terms *shape"]) -> Float[Array, "*shape"]:
    """The expected value, equation (32): the first coefficient."""
    return coefficients[0]


def variance(coefficients: Float[Array, "terms *shape"]) -> Float[Array, "*shape"]:
    """The variance, equation (33), summed from the second coefficient on (the mean is no part of it)."""
    return jnp.sum(coefficients[1:] ** 2, axis=0)


def std(coefficients: Float[Array, "terms *shape"]) -> Float[Array, "*shape"]:
    """The standard deviation, equation (33).

    Where the variance is exactly zero (an initial condition that is certain) the value is zero and so is the
    derivative: the root has no finite one there, and zero is its smallest subgradient.
    """
    spread = variance(coefficients)
    positive = spread > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, spread, 1.0)), 0.0)
