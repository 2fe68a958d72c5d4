"""Tail statistics: quantiles, probabilities, the mean beyond a quantile; density and distribution function.

All use the expansion along lines through the space of normal variables (see `_lines`). In up to three variables they
are exact to about 1e-8 for outputs that rise or fall throughout along a line. In more, probabilities of one output
between 1e-7 and one have relative errors of some percent, which `AbstractTail.estimated` tells, and far smaller ones
for outputs that are nearly linear in their tail. Entries of a path use fewer lines, or points (see
`_output_distribution`).
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library, jax_array, quietly
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, is_traced
from aleator._core.parallel import in_order
from aleator.statistics._lines import AnyLines, lines_through
from aleator.statistics._output_distribution import (
    EQUAL,
    AbstractOutputDistribution,
    DistributionByLines,
    Estimate,
    sloped,
    statistic_of,
)
from aleator.statistics._statistic import AbstractStatistic, level_given, number_given

# A spread that is no more than this part of a distance counts as none.
_NO_SPREAD = 1e-12
# Below this part of the largest spread along a path, what is away from the mean is rounding.
_FLAT = 1e-6


class AbstractTail(AbstractStatistic):
    """A statistic of an output's distribution along lines; all such statistics share the prepared lines.

    It has first derivatives only; second ones are zero.
    """

    needs_no_compiler: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., AnyLines]:
        return lines_through

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: AnyLines) -> Float[Array, "*shape"]:
        return statistic_of(self, coefficients, constants)

    def estimated(
        self, coefficients: Float[np.ndarray, "terms *shape"], constants: AnyLines
    ) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """The statistic by lines, and the 95 % half-width of its integral over the expansion, which is known."""
        known = sloped(self, np.asarray(coefficients), constants, by_lines_alone=True)
        return known.values, known.errors

    @abc.abstractmethod
    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        """The statistic of an output, and its error."""

    @abc.abstractmethod
    def tail(self, value: float) -> tuple[float, bool]:
        """The probability of the tail that it speaks of where it has a value, and whether that is the lower one."""

    @abc.abstractmethod
    def apart(
        self, mean: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "*m"]]:
        """How many standard deviations each entry of a path is apart from that which a limit would be decided by, and
        how many the statistic is away from the mean there, if entries were normally distributed.
        """


class AbstractAtLevel(AbstractTail):
    """A statistic of the tail beyond the quantile at a level."""

    level: Scalar

    speaks_of_one_system: ClassVar[bool] = True

    @quietly
    def along(
        self, coefficients: Float[np.ndarray, "terms instants *shape"], constants: AnyLines, every: int
    ) -> Float[np.ndarray, "instants *shape"]:
        """The statistic along a path, sought at every so many instants alone, the first and the last among these.

        In between, how many standard deviations it is away from the mean is interpolated, which changes as slowly as
        the shape of the distribution.
        """
        count, *shape = coefficients.shape[1:]
        mean, std = (
            one.reshape(count, -1) for one in (coefficients[0], np.sqrt(np.sum(coefficients[1:] ** 2, axis=0)))
        )
        known = sloped(self, coefficients[:, ::every], constants).values.reshape(-1, mean.shape[1])
        varies = std[::every] > _FLAT * np.nanmax(std, axis=0, initial=0.0)
        away = (known - mean[::every]) / np.where(varies, std[::every], 1.0)
        place, own = np.arange(count) / every, np.arange(len(known))
        between = [
            np.interp(place, own[some], one[some]) if some.any() else 0 * place
            for some, one in zip(varies.T, away.T, strict=True)
        ]
        return (mean + np.stack(between, axis=1) * std).reshape(count, *shape)

    @override
    def tail(self, value: float) -> tuple[float, bool]:
        return min(float(self.level), 1 - float(self.level)), float(self.level) < 0.5

    @override
    def apart(
        self, mean: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "*m"]]:
        away = scipy.special.ndtri(self.level)
        # The largest of quantiles above the mean, the smallest of those below it.
        normal = (-1.0 if away < 0 else 1.0) * mean + abs(away) * std
        behind = np.nanmax(normal, keepdims=True) - normal
        return behind / np.maximum(std, _NO_SPREAD * behind), np.abs(away)


@final
class Quantile(AbstractAtLevel):
    """The value that the output stays below with probability `level`."""

    def __init__(self, level: Scalar):
        self.level = level_given("Quantile", level)

    @override
    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        return distribution.quantile(self.level)

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """Linear interpolation between the sorted values."""
        library, values, level = in_library(values, self.level)
        return jax_array(library.quantile(values, level, axis=0))

    @override
    def text(self, inside: str) -> str:
        return f"Q{float(self.level):g}[{inside}]"


@final
class ConditionalValueAtRisk(AbstractAtLevel):
    """The mean of the values above the quantile at `level`, or of those below it with `lower=True`.

    A level of 0.95 gives the mean of the largest 5 %; 0.05 with `lower=True` that of the smallest 5 %. Source:
    Rockafellar and Uryasev (2000), Optimization of conditional value-at-risk.
    """

    lower: bool = eqx.field(static=True)

    def __init__(self, level: Scalar, *, lower: bool = False):
        self.level, self.lower = level_given("ConditionalValueAtRisk", level), bool(lower)

    @override
    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        return distribution.mean_beyond(self.level, lower=self.lower)

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        quantile = Quantile(self.level).of_sample(values)
        library, values, quantile, level = in_library(values, quantile, self.level)
        beyond = values - quantile[None]
        if self.lower:
            return jax_array(quantile - library.mean(library.maximum(-beyond, 0.0), axis=0) / level)
        return jax_array(quantile + library.mean(library.maximum(beyond, 0.0), axis=0) / (1 - level))

    @override
    def text(self, inside: str) -> str:
        return f"{'lower ' * self.lower}CVaR{float(self.level):g}[{inside}]"


@final
class Probability(AbstractTail):
    """The probability of `x > above`, of `x < below`, or of both at once, `above < x < below`.

    The probability outside of an interval is one minus that inside. Thresholds are in the unit of the output.
    """

    above: Scalar | None
    below: Scalar | None

    dimensionless: ClassVar[bool] = True

    def __init__(self, *, above: Scalar | None = None, below: Scalar | None = None):
        if above is None and below is None:
            raise ProblemError("Probability: expected a threshold, above=... or below=... or both; received neither.")
        self.above = None if above is None else number_given("Probability", "above", above)
        self.below = None if below is None else number_given("Probability", "below", below)
        known = [limit for limit in (self.above, self.below) if limit is not None and not is_traced(limit)]
        if len(known) == 2 and not float(known[0]) < float(known[1]):
            raise ProblemError(
                f"Probability: above < x < below needs above < below; received above={above}, below={below}. The "
                "probability outside of an interval is one minus that inside."
            )

    @override
    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        if self.above is None or self.below is None:
            return distribution.chance(self._thresholds[0], above=self.below is None)
        return distribution.between(self.above, self.below)

    @property
    def _thresholds(self) -> list[Scalar]:
        return [threshold for threshold in (self.above, self.below) if threshold is not None]

    @override
    def apart(
        self, mean: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "*m"]]:
        away = np.min([np.abs(threshold - mean) for threshold in self._thresholds], axis=0)
        scores = away / np.maximum(std, _NO_SPREAD * away)
        nearest = np.nanmin(scores, keepdims=True)
        return scores - nearest, nearest

    @override
    def tail(self, value: float) -> tuple[float, bool]:
        return min(value, 1 - value), (self.below is not None) == (value < 0.5)

    @quietly
    def holds(self, values: Float[Array | np.ndarray, "*shape"], *, is_rounded: bool = False) -> Bool[Array, "*shape"]:
        """Which of some values are in the event; with `is_rounded`, none that differ from a threshold by rounding."""
        library, values, above, below = in_library(values, self.above, self.below)
        inside = library.ones(values.shape, bool)
        rounding = EQUAL * library.sqrt(library.mean(values**2)) if is_rounded else 0.0
        if above is not None:
            inside = inside & (values > above + rounding)
        return inside if below is None else inside & (values < below - rounding)

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The proportion of the sample."""
        library, values, inside = in_library(values, self.holds(values))
        return jax_array(library.mean(library.where(library.isnan(values), np.nan, inside), axis=0))

    @override
    def text(self, inside: str) -> str:
        """`P[x > 3]`."""
        if self.above is None or self.below is None:
            sign, threshold = (">", self.above) if self.below is None else ("<", self.below)
            return f"P[{inside} {sign} {_brief(threshold)}]"
        return f"P[{_brief(self.above)} < {inside} < {_brief(self.below)}]"


@final
class Widened(AbstractStatistic):
    """A probability of an output that is a factor as far from its mean in each system."""

    kind: Probability
    factor: Scalar

    dimensionless: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., AnyLines]:
        return self.kind.preparation

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: AnyLines) -> Float[Array, "*shape"]:
        mean, rest = coefficients[:1], coefficients[1:]
        return self.kind.of(jnp.concatenate([mean, self.factor * rest]), constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        mean = values.mean(axis=0)
        return self.kind.of_sample(mean + self.factor * (values - mean))

    @override
    def text(self, inside: str) -> str:
        return f"{self.kind.text(inside)} with {_brief(self.factor)} times the spread"


def _brief(threshold: Scalar | None) -> str:
    return f"{np.asarray(threshold):g}"


@final
class _AtMost(Module):
    """The probability of a value and of all below it."""

    value: Scalar

    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        return distribution.chance(self.value, above=False, or_equal=True)


@final
class _Density(Module):
    """The probability density at a value."""

    value: Scalar

    def of_distribution(self, distribution: AbstractOutputDistribution) -> Estimate:
        return distribution.density(self.value)


def cdf(
    values: Float[Array, " n"], coefficients: Float[Array, "terms *shape"], constants: AnyLines
) -> Float[Array, "n *shape"]:
    """The distribution function at some values, for each entry. Constants: `lines_through`."""
    return _at_each(_AtMost, values, coefficients, constants)


def pdf(
    values: Float[Array, " n"], coefficients: Float[Array, "terms *shape"], constants: AnyLines
) -> Float[Array, "n *shape"]:
    """The probability density at some values, per unit of the output, for each entry. Constants: `lines_through`.

    Its relative error is some ten times that of the probability of the smaller side, near an extreme of the output
    more. It has no derivatives.
    """
    return _at_each(_Density, values, coefficients, constants)


def _at_each(kind: Callable[[Any], Any], values: Array, coefficients: Array, lines: AnyLines) -> Array:
    if np.ndim(values) != 1:
        raise ProblemError(f"cdf and pdf: expected values of shape (n,); received {np.shape(values)}.")
    if is_traced((values, coefficients, lines)):
        kinds = [kind(value) for value in jnp.asarray(values, dtype=float)]
        return jnp.stack([statistic_of(one, coefficients, lines, by_lines_alone=True) for one in kinds])
    kinds, (terms, *shape) = [kind(value) for value in np.asarray(values, dtype=float).tolist()], coefficients.shape
    rows = np.asarray(coefficients).reshape(terms, -1).T
    known = jax.tree.map(np.asarray, lines).for_one_of(len(rows))

    def along(row: Float[np.ndarray, " terms"]) -> list[float]:
        if not np.isfinite(row).all():
            return [np.nan] * len(kinds)
        distribution = DistributionByLines(row, known)
        return [float(one.of_distribution(distribution).value) for one in kinds]

    return jax_array(np.array(list(in_order(along, rows))).reshape(len(rows), len(kinds)).T.reshape(-1, *shape))
