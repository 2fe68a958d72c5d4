"""Tail statistics: quantiles, probabilities, the mean beyond a quantile; density and distribution function.

All use the expansion along lines through the space of normal variables (see `_lines`). In up to three variables they
are exact to about 1e-8 for smooth outputs. In more, probabilities of one output between 1e-7 and one have relative
errors of some percent, which `AbstractTail.estimated` tells, and far smaller ones for outputs that are nearly linear in
their tail. Entries of a path use fewer lines, or points (see `_output_distribution`). Where coefficients are known, all
of it is NumPy (see `_known_tails`).
"""

import abc
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library, jax_array, quietly
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_traced
from aleator.statistics._lines import AnyLines, lines_through
from aleator.statistics._lower_tails import EQUAL, normal_score
from aleator.statistics._output_distribution import (
    Estimate,
    OutputDistribution,
    TailOf,
    by_lines,
    estimate_of_row,
    rows_of,
    sloped,
    statistics_of_rows,
)
from aleator.statistics._statistic import AbstractStatistic, Constants, level_given, number_given

# A spread that is no more than this part of a distance counts as none.
_NO_SPREAD = 1e-12


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
        return tails_together([self], [coefficients], constants)[0]

    def estimated(
        self, coefficients: Float[Array, "terms *shape"], constants: AnyLines
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """The statistic by lines, and the 95 % half-width of its integral over the expansion."""
        if not is_traced((self, coefficients, constants)):
            known = sloped(self, np.asarray(coefficients), constants, by_lines_alone=True)
            return jax_array(known.values), jax_array(known.errors)
        rows, lines = rows_of([self], [coefficients]), constants.for_one_of(coefficients[0].size)
        value, error = by_lines(partial(estimate_of_row, jax.tree.structure(self)), rows, lines)
        return value.reshape(coefficients.shape[1:]), error.reshape(coefficients.shape[1:])

    @abc.abstractmethod
    def of_distribution(self, distribution: OutputDistribution) -> Estimate:
        """The statistic of an output, and its error."""

    @abc.abstractmethod
    def tail(self, value: float) -> tuple[float, bool]:
        """The probability of the tail that it speaks of where it has a value, and whether that is the lower one."""

    @abc.abstractmethod
    def apart(self, mean: Float[Array, " n"], std: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, "*n"]]:
        """How many standard deviations each entry of a path is apart from that which a limit would be decided by, and
        how many the statistic is away from the mean there, if entries were normally distributed.
        """


class AbstractAtLevel(AbstractTail):
    """A statistic of the tail beyond the quantile at a level."""

    level: Scalar

    speaks_of_one_system: ClassVar[bool] = True

    @override
    def tail(self, value: float) -> tuple[float, bool]:
        return min(float(self.level), 1 - float(self.level)), float(self.level) < 0.5

    @override
    def apart(self, mean: Float[Array, " n"], std: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, "*n"]]:
        library, mean, std, away = in_library(mean, std, normal_score(self.level))
        # The largest of quantiles above the mean, the smallest of those below it.
        normal = library.where(away < 0, -1.0, 1.0) * mean + library.abs(away) * std
        behind = library.nanmax(normal, axis=-1, keepdims=True) - normal
        return behind / library.maximum(std, _NO_SPREAD * behind), library.abs(away)


@final
class Quantile(AbstractAtLevel):
    """The value that the output stays below with probability `level`."""

    def __init__(self, level: Scalar):
        self.level = level_given("Quantile", level)

    @override
    def of_distribution(self, distribution: OutputDistribution) -> Estimate:
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
    def of_distribution(self, distribution: OutputDistribution) -> Estimate:
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
    def of_distribution(self, distribution: OutputDistribution) -> Estimate:
        if self.above is None or self.below is None:
            return distribution.chance(self._thresholds[0], above=self.below is None)
        return distribution.between(self.above, self.below)

    @property
    def _thresholds(self) -> list[Scalar]:
        return [threshold for threshold in (self.above, self.below) if threshold is not None]

    @override
    def apart(self, mean: Float[Array, " n"], std: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, "*n"]]:
        library, mean, std, thresholds = in_library(mean, std, self._thresholds)
        away = [library.abs(threshold - mean) for threshold in thresholds]
        scores = library.min(library.stack(away), axis=0) / library.maximum(std, _NO_SPREAD * away[0])
        nearest = library.nanmin(scores, axis=-1, keepdims=True)
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


def _brief(threshold: Scalar | None) -> str:
    return f"{np.asarray(threshold):g}"


def tails_together(
    kinds: Sequence[AbstractTail], coefficients: Sequence[Float[Array, "terms *shape"]], constants: AnyLines
) -> list[Float[Array, "*shape"]]:
    """Tails of one class and structure, of outputs of one shape; where they are traced, in one loop for all."""
    if not is_traced((kinds, coefficients, constants)):
        pairs = zip(kinds, coefficients, strict=True)
        return [jax_array(sloped(kind, np.asarray(terms), constants).values) for kind, terms in pairs]
    rows = rows_of(kinds, coefficients)
    values = statistics_of_rows(jax.tree.structure(kinds[0]), rows, constants, len(kinds))
    return list(values.reshape(len(kinds), *coefficients[0].shape[1:]))


def cdf(
    values: Float[Array, " n"], coefficients: Float[Array, "terms *shape"], constants: AnyLines
) -> Float[Array, "n *shape"]:
    """The distribution function at some values, for each entry. Constants: `lines_through`."""
    return _at_each(
        lambda output, value: output.chance(value, above=False, or_equal=True).value, values, coefficients, constants
    )


def pdf(
    values: Float[Array, " n"], coefficients: Float[Array, "terms *shape"], constants: AnyLines
) -> Float[Array, "n *shape"]:
    """The probability density at some values, per unit of the output, for each entry. Constants: `lines_through`.

    At an extremum of an output along a line its density is infinite, which shows as noise near the extremes.
    """
    return _at_each(OutputDistribution.density, values, coefficients, constants)


def _at_each(
    function: Callable[[OutputDistribution, Array], Array], values: Array, coefficients: Array, lines: AnyLines
) -> Array:
    values = jnp.asarray(values, dtype=float)
    if values.ndim != 1:
        raise ProblemError(f"cdf and pdf: expected values of shape (n,); received {values.shape}.")

    def every(row: Float[Array, " terms"], tail_of: TailOf) -> Float[Array, " n"]:
        return jax.lax.map(lambda value: function(OutputDistribution(row, tail_of), value), values)

    rows = coefficients.reshape(len(coefficients), -1)
    return by_lines(every, rows, lines.for_one_of(rows.shape[1])).reshape(len(values), *coefficients.shape[1:])


def together(
    statistics: Sequence[tuple[AbstractStatistic, Float[Array, "terms ..."]]], constants: Constants
) -> list[Float[Array, "..."] | None]:
    """The values of statistics that share one loop, which is compiled as fast as for one of them; None for the rest."""
    alike: dict[tuple, list[int]] = {}
    for i, (kind, coefficients) in enumerate(statistics):
        if isinstance(kind, AbstractTail):
            alike.setdefault((jax.tree.structure(kind), coefficients.shape), []).append(i)
    values: list[Array | None] = [None] * len(statistics)
    for places in alike.values():
        if len(places) > 1:
            kinds, terms = zip(*(statistics[i] for i in places), strict=True)
            for i, value in zip(places, tails_together(kinds, terms, constants.of(kinds[0])), strict=True):
                values[i] = value
    return values
