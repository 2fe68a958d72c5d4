"""The shape of an output's distribution, from the third and fourth power of its expansion: exact, without sampling."""

from collections.abc import Callable
from typing import ClassVar, final

import jax.numpy as jnp
from jax.scipy.special import ndtri
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, Scalar, in_library, jax_array, quietly
from aleator._core.units import PURE
from aleator.statistics._given import level_given
from aleator.statistics._moments import Mean, Std, varies
from aleator.statistics._square import Square, square
from aleator.statistics._statistic import AbstractStatistic, entry_by_entry

_TOGETHER = 64


@final
class Skewness(AbstractStatistic):
    """The skewness `E[(y - mean)^3] / std^3`: zero for a normal distribution, and where the output does not vary."""

    symbol: ClassVar[str] = "Skew"

    @property
    @override
    def preparation(self) -> Callable[..., Square]:
        return square

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Square) -> Float[Array, "*shape"]:
        return shape_of(coefficients, constants)[0]

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return _power_mean(values, 3)

    @override
    def unit(self, *of: str) -> str:
        del of
        return PURE


@final
class Kurtosis(AbstractStatistic):
    """The kurtosis `E[(y - mean)^4] / std^4`, not the excess: 3 for a normal distribution, zero if nothing varies."""

    symbol: ClassVar[str] = "Kurt"

    @property
    @override
    def preparation(self) -> Callable[..., Square]:
        return square

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Square) -> Float[Array, "*shape"]:
        return shape_of(coefficients, constants)[1]

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return _power_mean(values, 4)

    @override
    def unit(self, *of: str) -> str:
        del of
        return PURE


@final
class CornishFisher(AbstractStatistic):
    """An approximate quantile from the first four moments: smooth, cheap, and accurate if nearly normal.

    Source: Cornish and Fisher (1938), Moments and cumulants in the specification of distributions.
    """

    level: Scalar

    def __init__(self, level: Scalar):
        self.level = level_given("CornishFisher", level)

    @property
    @override
    def preparation(self) -> Callable[..., Square]:
        return square

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Square) -> Float[Array, "*shape"]:
        skewness, kurtosis = shape_of(coefficients, constants)
        return self._quantile(Mean().of(coefficients, ()), Std().of(coefficients, ()), skewness, kurtosis)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        kinds = (Mean(), Std(), Skewness(), Kurtosis())
        return self._quantile(*(kind.of_sample(values) for kind in kinds))

    def _quantile(self, mean: Array, std: Array, skewness: Array, kurtosis: Array) -> Float[Array, "*shape"]:
        z = ndtri(jnp.asarray(self.level, dtype=float))
        normal = z + (z**2 - 1) * skewness / 6 + (z**3 - 3 * z) * (kurtosis - 3) / 24
        return mean + std * (normal - (2 * z**3 - 5 * z) * skewness**2 / 36)

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True

    @override
    def text(self, inside: str) -> str:
        return f"CF{float(self.level):g}[{inside}]"


def shape_of(
    coefficients: Float[Array, "terms *shape"], constants: Square
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Skewness and kurtosis: with the expansion of `y^2`, `E[y^3]` and `E[y^4]` are sums as in equation (33)."""

    def both(terms: Float[Array, " terms"]) -> Float[Array, "2"]:
        spreads = varies(terms)
        std = Std().of(terms, ())
        standard = jnp.where(spreads, terms.at[0].set(0.0) / jnp.where(spreads, std, 1.0), 0.0)
        squared = constants.of(standard)
        return jnp.stack([squared[: len(standard)] @ standard, jnp.sum(squared**2)])

    moments: Pytree = entry_by_entry(both, coefficients, _TOGETHER)
    return moments[..., 0], moments[..., 1]


@quietly
def _power_mean(values: Float[Array, "samples *shape"], power: int) -> Float[Array, "*shape"]:
    """The mean power of a sample that is shifted and scaled to mean zero and (biased) variance one."""
    library, values = in_library(values)
    away = values - library.mean(values, axis=0)[None]
    square_mean = library.mean(away**2, axis=0)
    standard = away / library.sqrt(library.where(square_mean > 0, square_mean, 1.0))[None]
    return jax_array(library.mean(standard**power, axis=0))
