"""Moments of an expansion in an orthonormal basis, from its coefficients alone (equations 30-33, 98, 99)."""

from typing import ClassVar, final

from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array, quietly
from aleator._core.units import squared
from aleator.statistics._statistic import AbstractStatistic


@final
class Mean(AbstractStatistic):
    """The expected value, equation (32): the first coefficient."""

    symbol: ClassVar[str] = "μ"

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        _, coefficients = in_library(coefficients)
        return jax_array(coefficients[0])

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        return jax_array(library.mean(values, axis=0))

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True


@final
class Variance(AbstractStatistic):
    """The variance, equation (33): the sum of squares from the second coefficient on."""

    symbol: ClassVar[str] = "Var"

    @override
    @quietly
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        library, coefficients = in_library(coefficients)
        return jax_array(library.sum(coefficients[1:] ** 2, axis=0))

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        return jax_array(library.var(values, axis=0, ddof=1))

    @override
    def unit(self, *of: str) -> str:
        return squared(*of)


@final
class Std(AbstractStatistic):
    """The standard deviation, equation (33).

    Where the variance is exactly zero, as for a certain initial condition, so is the derivative: the root has no finite
    one there, and zero is the subgradient of smallest norm.
    """

    symbol: ClassVar[str] = "σ"

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        return root(Variance().of(coefficients, constants))

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return root(Variance().of_sample(values))


# Outputs that vary by less than this part of their size are constant up to rounding.
_ROUNDING = 1e-12


@quietly
def varies(coefficients: Float[Array, "terms *shape"]) -> Bool[Array, "*shape"]:
    """Whether an output varies beyond rounding. NaN and infinite values count as varying."""
    library, coefficients = in_library(coefficients)
    variance = library.sum(coefficients[1:] ** 2, axis=0)
    constant = (variance == 0) | (variance < _ROUNDING**2 * library.sum(coefficients**2, axis=0))
    return jax_array(~constant)


@quietly
def root(square: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The square root, with derivative zero at zero; zero for negative numbers, which only rounding causes."""
    # Compared with `<=` so that NaN propagates.
    library, square = in_library(square)
    zero = square <= 0
    return jax_array(library.where(zero, 0.0, library.sqrt(library.where(zero, 1.0, square))))
