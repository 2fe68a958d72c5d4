"""How two outputs vary together: covariance and correlation, from the coefficients of both."""

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator._core.units import PURE, product
from aleator.statistics._moments import root
from aleator.statistics._statistic import AbstractStatistic


@final
class Covariance(AbstractStatistic):
    """The covariance of two outputs, stacked along the last axis: the inner product of their coefficients.

    The first coefficients, the means, are left out, as in equation (33).
    """

    symbol: ClassVar[str] = "Cov"

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        first, second = _both(coefficients[1:])
        return jnp.sum(first * second, axis=0)

    @override
    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        first, second = _both(values - jnp.mean(values, axis=0)[None])
        return jnp.sum(first * second, axis=0) / (len(values) - 1)

    @override
    def unit(self, *of: str) -> str:
        return product(*of)


@final
class CoefficientProduct(AbstractStatistic):
    """`Σ_j |a^j b^j|` of two outputs, stacked along the last axis: the printed form of the expected power (83).

    It depends on the basis, not on the two outputs alone, so that no sample estimates it. With a `smoothing` `s`, `|x|`
    is `sqrt(x² + s²) - s`.
    """

    symbol: ClassVar[str] = "Σ|·|"
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        first, second = _both(coefficients)
        products, s = first * second, self.smoothing
        return jnp.sum(jnp.sqrt(products**2 + s**2) - s if s else jnp.abs(products), axis=0)

    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        """NaN, because no sample estimates it."""
        return jnp.full(values.shape[1:-1], jnp.nan)

    @override
    def unit(self, *of: str) -> str:
        return product(*of)


@final
class Correlation(AbstractStatistic):
    """The correlation coefficient of two outputs, stacked along the last axis: between -1 and 1.

    It is zero, with derivative zero, if one of them does not vary.
    """

    symbol: ClassVar[str] = "Corr"

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        return _cosine(coefficients[1:])

    @override
    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        return _cosine(values - jnp.mean(values, axis=0)[None])

    @override
    def unit(self, *of: str) -> str:
        del of
        return PURE


def _cosine(vectors: Float[Array, "n *shape 2"]) -> Float[Array, "*shape"]:
    first, second = _both(vectors)
    # One root each, because the product of both squares overflows earlier.
    size = root(jnp.sum(first**2, axis=0)) * root(jnp.sum(second**2, axis=0))
    constant = size == 0
    return jnp.where(constant, 0.0, jnp.sum(first * second, axis=0) / jnp.where(constant, 1.0, size))


def _both(stacked: Float[Array, "n *shape outputs"]) -> tuple[Float[Array, "n *shape"], Float[Array, "n *shape"]]:
    if stacked.ndim < 2 or stacked.shape[-1] != 2:
        raise ProblemError(
            "Covariance and Correlation are of two outputs, stacked along the last axis: expected the shape "
            f"(terms, ..., 2); received {stacked.shape}."
        )
    return stacked[..., 0], stacked[..., 1]
