"""The distribution of an output from its expansion, by lines through the normal variables (see `_lines`) or by points.

Small probabilities of either tail come from lines of their own: those for small values of the output, or of its
negative. A probability is that of the smaller side. First derivatives are exact up to the error of the integral; second
derivatives are not available.
"""

import abc
import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.leaves import Module
from aleator.statistics._lines import END, Cloud, Lines, LineValues
from aleator.statistics._roots import horner, root_within, with_slope
from aleator.statistics._statistic import root

# Of a search for a quantile: most steps, and the width of a bracket at which it ends.
_MOST_STEPS, _NARROW = 100, 1e-13

EQUAL = 1e-14
"""Values of an output that differ by this part of its root mean square are equal."""

_NODES, _WEIGHTS = (np.asarray(each) / 2 for each in np.polynomial.legendre.leggauss(3))
_NODES = _NODES + 0.5


class Cut(NamedTuple):
    """Where an output crosses a threshold, without derivatives.

    - `below`: the probability below the threshold; `density`: of the output there; the rest is of lines alone;
    - `inside`: the parts of cells that lie below it as a whole;
    - `fractions`: the probability below the threshold on each line;
    - `line`, `cell`, `along`: of each crossing, in standard deviations; `densities`: of the output there on its line,
      zero for places without a crossing;
    - `start`, `length`: the part of the cell that is below the threshold.
    """

    below: Float[Array, ""]
    density: Float[Array, ""]
    inside: Bool[Array, "2 lines cells"]
    fractions: Float[Array, " lines"]
    line: Int[Array, " crossings"]
    cell: Int[Array, " crossings"]
    along: Float[Array, " crossings"]
    densities: Float[Array, " crossings"]
    start: Float[Array, " crossings"]
    length: Float[Array, " crossings"]


class AbstractLowerTail(Module):
    """What lies below a threshold, of an output with mean zero, or of its negative.

    `close`: the error of the normal score at which the search for a quantile ends; the last step, which carries the
    derivative, squares it.
    """

    close: ClassVar[float]

    std: Float[Array, ""]

    @abc.abstractmethod
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        """The output at a threshold. Not differentiable."""

    @abc.abstractmethod
    def below(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        """The probability below a threshold, with derivatives."""

    @abc.abstractmethod
    def shortfall(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        """The expected shortfall below a threshold, zero for values above it."""

    @abc.abstractmethod
    def error(self, at: Cut) -> Float[Array, ""]:
        """The 95 % half-width of the probability below a threshold."""

    def quantile(self, level: Scalar) -> tuple[Float[Array, ""], Cut]:
        """The quantile by the implicit function theorem, and the output there."""
        end = jax.lax.stop_gradient(jax.lax.stop_gradient(self)._searched(jax.lax.stop_gradient(level)))
        density = self.slope(end)
        step = (self.below(end.last, end.cut) - level) / jnp.where(density > 0, density, 1.0)
        return end.last - jnp.where(density > 0, step, 0.0), end.cut

    def slope(self, end: "Search") -> Float[Array, ""]:
        """The density at a quantile; zero where it is one of many systems at once."""
        return end.cut.density

    def _searched(self, level: Scalar) -> "Search":
        """Newton's method on the normal scale, on which most distribution functions are nearly straight.

        Bisection where a step leaves the bracket or does not halve the error: near an extremum of the output the
        density is without bound, and steps are short far from the quantile. The first bracket is that of Cantelli's
        inequality.
        """
        target, reach = normal_score(level), 1.01 * self.std
        low, high = -reach * jnp.sqrt((1 - level) / level), reach * jnp.sqrt(level / (1 - level))

        def unfinished(state: Search) -> Bool[Array, ""]:
            is_wide = state.high - state.low > _NARROW * self.std
            return (jnp.abs(state.off) > self.close) & is_wide & (state.steps < _MOST_STEPS)

        def narrow(state: Search) -> Search:
            at = state.following
            cut = self.cut(at)
            is_low = cut.below < level
            low, high = jnp.where(is_low, at, state.low), jnp.where(is_low, state.high, at)
            score = normal_score(cut.below)
            off = jnp.where(jnp.isfinite(score), score - target, jnp.inf)
            newton = at - off * _normal(score) / cut.density
            usable = (newton > low) & (newton < high) & (jnp.abs(off) <= jnp.abs(state.off) / 2)
            following = jnp.where(usable, newton, (low + high) / 2)
            return Search(low, high, following, at, off, cut, state.steps + 1)

        start = jnp.clip(self.std * target, low, high)
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(self.cut, start))
        first = Search(low, high, start, start, jnp.asarray(jnp.inf), nothing, jnp.zeros((), int))
        return jax.lax.while_loop(unfinished, narrow, first)


class Search(NamedTuple):
    """The state of the search for a quantile: a bracket, the thresholds to come and last, how far the normal score of
    the last one is off, and the output there.
    """

    low: Float[Array, ""]
    high: Float[Array, ""]
    following: Float[Array, ""]
    last: Float[Array, ""]
    off: Float[Array, ""]
    cut: Cut
    steps: Int[Array, ""]


@final
class TailByLines(AbstractLowerTail):
    """The probability below a threshold as the mean over lines.

    - `signed`: the coefficients of the output or of its negative; `values`: its values along the lines;
    - `ends`, `heights`: places in each cell between which the output rises or falls, and its values there;
    - `masses`: the probability of each such interval on its line.
    """

    close: ClassVar[float] = 1e-7

    signed: Float[Array, " terms"]
    values: LineValues
    ends: Float[Array, "3 lines cells"]
    heights: Float[Array, "3 lines cells"]
    masses: Float[Array, "2 lines cells"]
    lines: Lines

    @classmethod
    def of(cls, signed: Float[Array, " terms"], lines: Lines) -> "TailByLines":
        """That of an output with mean zero."""
        values = lines.along(signed)
        fixed = jax.lax.stop_gradient(values.cubics)
        _, slope, bend, rest = fixed
        # A cubic between ends with slopes of different signs has one extremum there.
        turns = slope * (slope + 2 * bend + 3 * rest) < 0
        radicand = root(bend**2 - 3 * rest * slope)
        larger = -(bend + jnp.where(bend < 0, -1.0, 1.0) * radicand)
        near, far = _ratio(slope, larger), _ratio(larger, 3 * rest)
        middle = jnp.where(turns, jnp.clip(jnp.where((near > 0) & (near < 1), near, far), 0.0, 1.0), 1.0)
        ends = jnp.stack([0 * middle, middle, 1 + 0 * middle])
        along = lines.first_of(jnp.arange(ends.shape[2]))[None, None] + ends * lines.step
        masses = -jnp.diff(_beyond(along), axis=0)
        return cls(root(jnp.sum(signed**2)), signed, values, ends, horner(fixed, ends), masses, lines)

    @override
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        is_below = self.heights < threshold
        low, high = is_below[:-1], is_below[1:]
        _, count, cells = self.heights.shape
        (intervals,) = jnp.nonzero((low != high).ravel(), size=self.lines.orders * count, fill_value=low.size)
        at = jnp.minimum(intervals, low.size - 1)
        cell, line = at % cells, (at // cells) % count
        left, right = (side.ravel()[at] for side in (self.ends[:-1], self.ends[1:]))
        is_falling = high.ravel()[at]
        cubic = self.values.cubics[:, line, cell].at[0].add(-threshold)
        place = root_within(cubic, left[None], right[None], ~is_falling[None], (left + right)[None] / 2)[0]
        start, end = jnp.where(is_falling, place, left), jnp.where(is_falling, right, place)
        step, first = self.lines.step, self.lines.first_of(cell)
        along = first + place * step
        is_crossing = intervals < low.size
        parts = jnp.where(is_crossing, _beyond(first + start * step) - _beyond(first + end * step), 0.0)
        inside = low & high
        whole = jnp.sum(jnp.where(inside, self.masses, 0.0), axis=(0, 2))
        slope = jnp.abs(with_slope(cubic, place[None])[1][0]) / step
        regular = is_crossing & (slope > 0)
        densities = jnp.where(regular, _normal(along) / jnp.where(regular, slope, 1.0), 0.0)
        fractions = whole + jax.ops.segment_sum(parts, line, count)
        weights = self.values.weights.ravel() / len(self.values.weights)
        length = jnp.where(is_crossing, end - start, 0.0)
        density = weights[line] @ densities
        return Cut(weights @ fractions, density, inside, fractions, line, cell, along, densities, start, length)

    @override
    def below(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        """Its derivative is that of the output at the crossings times the density there."""
        points = self.values.points[:, at.line] + jnp.outer(self.values.direction, at.along)
        heights = self.lines.values(self.signed, points) - threshold
        change = heights - jax.lax.stop_gradient(heights)
        weights = self.values.weights.ravel()
        return (weights @ at.fractions - (weights[at.line] * at.densities) @ change) / len(self.values.weights)

    @override
    def shortfall(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        """It is zero at the crossings, so that their movement does not contribute to its derivative."""
        inside = jnp.where(at.inside, self.ends[1:] - self.ends[:-1], 0.0)
        everywhere = self.lines.first_of(jnp.arange(self.heights.shape[2]))[None, None]
        cubics, weights, step = self.values.cubics, self.values.weights.ravel(), self.lines.step
        whole = _shortfall(cubics, self.ends[:-1], inside, everywhere, threshold, step)
        first = self.lines.first_of(at.cell)[None]
        parts = _shortfall(cubics[:, at.line, at.cell], at.start[None], at.length[None], first, threshold, step)[0]
        return (weights @ jnp.sum(whole, axis=(0, 2)) + weights[at.line] @ parts) / len(self.values.weights)

    @override
    def error(self, at: Cut) -> Float[Array, ""]:
        """By the scatter of the replicates: all of them together are more accurate, as parts of one net.

        Zero where one line is exact.
        """
        weights = self.values.weights
        replicates = len(weights)
        if replicates == 1:
            return jnp.zeros(())
        each = jnp.sum(weights * at.fractions.reshape(weights.shape), axis=1) / jnp.sum(weights, axis=1)
        covers = float(scipy.special.stdtrit(replicates - 1, 0.975)) / math.sqrt(replicates)
        return covers * jnp.std(each, ddof=1)


def _shortfall(
    cubic: Float[Array, "4 ..."], start: Array, length: Array, first: Array, threshold: Array, step: float
) -> Array:
    """The integral of the shortfall over a part of each cell, by Gauss's rule."""
    total = jnp.zeros(start.shape)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        place = start + node * length
        density = weight * length * step * _normal(first + place * step)
        total = total + density * (threshold - horner(cubic, place))
    return total


def _ratio(above: Array, below: Array) -> Array:
    return jnp.where(below == 0, 2.0, above / jnp.where(below == 0, 1.0, below))


def _normal(at: Array) -> Array:
    return jnp.exp(-(at**2) / 2) / math.sqrt(2 * math.pi)


def _beyond(at: Array) -> Array:
    """The probability of a normal variable beyond a number, where lines have their small values, as far as lines go."""
    outside = math.erfc(END / math.sqrt(2)) / 2
    return (jax.lax.erfc(at / math.sqrt(2)) / 2 - outside) / (1 - 2 * outside)


def normal_score(probability: Scalar) -> Array:
    """The normal quantile of a probability."""
    return math.sqrt(2) * jax.lax.erf_inv(2 * jnp.asarray(probability) - 1)


@final
class TailByPoints(AbstractLowerTail):
    """The probability below a threshold by points that are the same for all outputs: a matrix product, and a sum.

    Each point is spread out by a kernel of fourth order, a polynomial within its width.
    """

    close: ClassVar[float] = 1e-4

    values: Float[Array, " points"]
    width: Float[Array, ""]

    @classmethod
    def of(cls, signed: Float[Array, " terms"], cloud: Cloud) -> "TailByPoints":
        """That of an output with mean zero."""
        std = root(jnp.sum(signed**2))
        width = jnp.maximum(cloud.width * jax.lax.stop_gradient(std), np.finfo(float).tiny)
        return cls(std, signed @ cloud.terms, width)

    def _places(self, threshold: Float[Array, ""]) -> Float[Array, " points"]:
        return (threshold - self.values) / self.width

    @override
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        square = jnp.minimum(self._places(threshold) ** 2, 1.0)
        density = jnp.mean((1 - square) * (3 - 7 * square)) * 15 / 32 / self.width
        none = jnp.zeros(0)
        return Cut(self.below(threshold, ()), density, *[none] * 8)

    @override
    def below(self, threshold: Float[Array, ""], at: object) -> Float[Array, ""]:
        place = jnp.clip(self._places(threshold), -1.0, 1.0)
        square = place**2
        return jnp.mean(0.5 + place * (45 - square * (50 - 21 * square)) / 32)

    @override
    def shortfall(self, threshold: Float[Array, ""], at: object) -> Float[Array, ""]:
        place = self._places(threshold)
        square = jnp.minimum(place**2, 1.0)
        inside = jnp.clip(place, -1.0, 1.0) / 2 + (5 + square * (45 - square * (25 - 7 * square))) / 64
        return self.width * jnp.mean(inside + jnp.maximum(place - 1, 0.0))

    @override
    def error(self, at: Cut) -> Float[Array, ""]:
        """Unknown."""
        return jnp.asarray(jnp.nan)


TailOf: TypeAlias = Callable[[Float[Array, " terms"]], AbstractLowerTail]
"""The lower tail of an output by its coefficients, the first of which is zero."""


class Estimate(NamedTuple):
    """A statistic, and the 95 % half-width of its integral over the expansion."""

    value: Float[Array, ""]
    error: Float[Array, ""]


@final
class OutputDistribution(NamedTuple):
    """The distribution of an output, whose tails some function gives: the upper one as that of its negative."""

    coefficients: Float[Array, " terms"]
    tail_of: TailOf

    def _side(self, is_lower: Bool[Array, ""]) -> tuple[Array, AbstractLowerTail]:
        sign = jnp.where(is_lower, 1.0, -1.0)
        return sign, self.tail_of(sign * self.coefficients.at[0].set(0.0))

    def chance(self, value: Scalar, *, above: bool, or_equal: bool = False) -> Estimate:
        """The probability of more than a value, or of less, without loss of digits where it is small.

        What equals the value but for rounding, as systems at a stop do, counts only with `or_equal`.
        """
        rounding = jax.lax.stop_gradient(EQUAL * root(jnp.sum(self.coefficients**2)))
        off = jnp.asarray(value) - self.coefficients[0] + (rounding if above != or_equal else -rounding)
        is_lower = off < 0
        sign, tail = self._side(is_lower)
        at = jax.lax.stop_gradient(tail.cut(sign * off))
        beyond = tail.below(sign * off, at)
        return Estimate(jnp.where(is_lower != above, beyond, 1 - beyond), tail.error(at))

    def density(self, value: Float[Array, ""]) -> Float[Array, ""]:
        """The probability density at a value. Not differentiable."""
        off = value - self.coefficients[0]
        sign, tail = self._side(off < 0)
        return tail.cut(sign * off).density

    def quantile(self, level: Scalar) -> Estimate:
        """The value that the output stays below with a probability."""
        is_lower = jnp.asarray(level) < 0.5
        sign, tail = self._side(is_lower)
        quantile, at = tail.quantile(jnp.where(is_lower, level, 1 - level))
        error = tail.error(at) / jnp.where(at.density > 0, at.density, jnp.inf)
        return Estimate(self.coefficients[0] + sign * quantile, error)

    def mean_beyond(self, level: Scalar, *, lower: bool) -> Estimate:
        """The mean of the values below a quantile, or above it."""
        is_lower = jnp.asarray(level) < 0.5
        own = jnp.where(is_lower, level, 1 - level)
        sign, tail = self._side(is_lower)
        quantile, at = tail.quantile(own)
        below = quantile - tail.shortfall(quantile, at) / own
        # The mean of all is zero, so that those on the other side of the quantile balance these.
        away = jnp.where(is_lower == lower, below, -below * own / (1 - own))
        # By the derivative of the mean beyond a quantile by the level.
        slope = jnp.abs(away - quantile) / (level if lower else 1 - level)
        return Estimate(self.coefficients[0] + sign * away, tail.error(at) * slope)
