"""The lower tail of an output from its expansion, by lines through the normal variables (see `_lines`).

First derivatives are exact up to the error of the integral; second derivatives are zero.
"""

import abc
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library
from aleator._core.leaves import Module
from aleator.statistics._cubics import (
    AT_REST,
    MOST_ITERATIONS,
    NODES,
    WEIGHTS,
    beyond,
    closer_to_root,
    density_of,
    extremum_within,
    horner,
    with_slope,
)
from aleator.statistics._lines import AnyLines, Lines, LinesInElements, LineValues
from aleator.statistics._statistic import root

# Of a search for a quantile: most steps, and the width of a bracket at which it ends.
MOST_STEPS, NARROW = 100, 1e-13

# An element varies by less than this part of the spread: not at all.
CONSTANT = 1e-9


EQUAL = 1e-14
"""Values of an output that differ by this part of its root mean square are equal."""


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
        target = normal_score(level)
        low, high = bracket_of(level, self.std)

        def unfinished(state: Search) -> Bool[Array, ""]:
            is_wide = state.high - state.low > NARROW * self.std
            return (jnp.abs(state.off) > self.close) & is_wide & (state.steps < MOST_STEPS)

        def narrow(state: Search) -> Search:
            at = state.following
            cut = self.cut(at)
            is_low = cut.below < level
            low, high = jnp.where(is_low, at, state.low), jnp.where(is_low, state.high, at)
            score = normal_score(cut.below)
            off = jnp.where(jnp.isfinite(score), score - target, jnp.inf)
            newton = at - off * density_of(score) / cut.density
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
        turns = slope * (slope + 2 * bend + 3 * rest) < 0
        middle = jnp.where(turns, extremum_within(slope, bend, rest), 1.0)
        ends = jnp.stack([0 * middle, middle, 1 + 0 * middle])
        along = lines.first_of(jnp.arange(ends.shape[2]))[None, None] + ends * lines.step
        masses = -jnp.diff(beyond(along), axis=0)
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
        parts = jnp.where(is_crossing, beyond(first + start * step) - beyond(first + end * step), 0.0)
        inside = low & high
        whole = jnp.sum(jnp.where(inside, self.masses, 0.0), axis=(0, 2))
        slope = jnp.abs(with_slope(cubic, place[None])[1][0]) / step
        regular = is_crossing & (slope > 0)
        densities = jnp.where(regular, density_of(along) / jnp.where(regular, slope, 1.0), 0.0)
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
        off = jax.lax.stop_gradient(heights)
        # What the output itself is off at the crossings of its cubics, unless it hardly rises there.
        is_near = jnp.abs(off * at.densities) < density_of(at.along) * self.lines.step
        change = heights - jnp.where(is_near, 0.0, off)
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
        return jnp.asarray(error_of(weights, at.fractions.reshape(weights.shape)))


def error_of(
    weights: Float[Any, "replicates lines_of_one"], fractions: Float[Any, "replicates lines_of_one"]
) -> Float[Any, ""]:
    """The 95 % half-width of a probability by the scatter of its replicates."""
    library, weights, fractions = in_library(weights, fractions)
    replicates = len(weights)
    if replicates == 1:
        return library.zeros(())
    each = library.sum(weights * fractions, axis=1) / library.sum(weights, axis=1)
    covers = float(scipy.special.stdtrit(replicates - 1, 0.975)) / math.sqrt(replicates)
    return covers * library.std(each, ddof=1)


def bracket_of(level: Scalar, std: Scalar) -> tuple[Any, Any]:
    """Between which values a quantile lies, by Cantelli's inequality."""
    library, level, std = in_library(level, std)
    reach = 1.01 * std
    return -reach * library.sqrt((1 - level) / level), reach * library.sqrt(level / (1 - level))


def _shortfall(
    cubic: Float[Array, "4 ..."], start: Array, length: Array, first: Array, threshold: Array, step: float
) -> Array:
    """The integral of the shortfall over a part of each cell, by Gauss's rule."""
    total = jnp.zeros(start.shape)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        place = start + node * length
        density = weight * length * step * density_of(first + place * step)
        total = total + density * (threshold - horner(cubic, place))
    return total


def root_within(
    powers: Float[Array, "orders *lines"],
    low: Float[Array, "points *lines"],
    high: Float[Array, "points *lines"],
    rising: Bool[Array, "points *lines"],
    start: Float[Array, "points *lines"],
) -> Float[Array, "points *lines"]:
    """The root of each polynomial between two places, from one to the other of which its sign changes."""

    def is_moving(state: tuple[Array, ...]) -> Bool[Array, ""]:
        *_, moving, count = state
        return moving & (count < MOST_ITERATIONS)

    def narrow(state: tuple[Array, ...]) -> tuple[Array, ...]:
        low, high, x, _, count = state
        low, high, closer = closer_to_root(powers, low, high, rising, x)
        return low, high, closer, jnp.any(jnp.abs(closer - x) > AT_REST), count + 1

    return jax.lax.while_loop(is_moving, narrow, (low, high, start, jnp.array(True), jnp.zeros((), int)))[2]


def normal_score(probability: Scalar) -> Array:
    """The normal quantile of a probability."""
    library, probability = in_library(probability)
    if library is np:
        return scipy.special.ndtri(probability)
    return math.sqrt(2) * jax.lax.erf_inv(2 * jnp.asarray(probability) - 1)


@final
class TailInElements(AbstractLowerTail):
    """The probability below a threshold as the sum over elements, `tails` of which are stacked."""

    close: ClassVar[float] = TailByLines.close

    tails: TailByLines
    probability: Float[Array, " elements"]

    @classmethod
    def of(cls, signed: Float[Array, " terms"], lines: LinesInElements) -> "TailInElements":
        """That of an output with mean zero."""
        tails = jax.vmap(TailByLines.of)(lines.division.elements(signed), lines.lines)
        return cls(root(jnp.sum(signed**2)), tails, lines.division.probability)

    @override
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        cuts = jax.vmap(TailByLines.cut, (0, None))(self.tails, threshold)
        return cuts._replace(below=self.probability @ cuts.below, density=self.probability @ cuts.density)

    @override
    def below(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        return self.probability @ self._each(TailByLines.below, threshold, at)

    @override
    def shortfall(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        return self.probability @ self._each(TailByLines.shortfall, threshold, at)

    @override
    def error(self, at: Cut) -> Float[Array, ""]:
        each = self._each(lambda tail, _, at: tail.error(at), jnp.zeros(()), at)
        return root(jnp.sum((self.probability * each) ** 2))

    @override
    def quantile(self, level: Scalar) -> tuple[Float[Array, ""], Cut]:
        """One that many systems share, as those of a stop do, moves with their elements, which are constant."""
        quantile, cut = super().quantile(level)
        middles, rest = self.tails.signed[:, 0], root(jnp.sum(self.tails.signed[:, 1:] ** 2, axis=1))
        is_shared = jnp.maximum(jnp.abs(middles - quantile), rest) <= CONSTANT * self.std
        shares = jax.lax.stop_gradient(jnp.where(is_shared, self.probability, 0.0))
        moved = shares @ (middles - jax.lax.stop_gradient(middles)) / jnp.maximum(jnp.sum(shares), np.finfo(float).tiny)
        return quantile + moved, cut

    @override
    def slope(self, end: Search) -> Float[Array, ""]:
        return jnp.where(jnp.abs(end.off) <= self.close, end.cut.density, 0.0)

    def _each(self, function: Callable[..., Array], threshold: Array, at: Cut) -> Float[Array, " elements"]:
        axes: Any = Cut(*[None, None], *[0] * (len(Cut._fields) - 2))  # type: ignore[arg-type]
        return jax.vmap(function, (0, None, axes))(self.tails, threshold, at)


def lower_tail(signed: Float[Array, " terms"], lines: AnyLines) -> AbstractLowerTail:
    """The lower tail of an output by its coefficients, the first of which is zero."""
    return TailInElements.of(signed, lines) if isinstance(lines, LinesInElements) else TailByLines.of(signed, lines)
