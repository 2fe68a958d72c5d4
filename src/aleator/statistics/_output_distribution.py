"""The distribution of an output, from its expansion along lines through the normal variables (see `_lines`).

Small probabilities of either tail come from lines of their own: with the probability `A` of less than a threshold by
the lines for small values, and `B` of more than it by those for large ones, the distribution function is `A / (A + B)`.
First derivatives are exact up to the error of the integral. Second derivatives are not available.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import Scalar
from aleator._core.leaves import Module
from aleator.statistics._lines import REPLICATES, Lines, LowerTail
from aleator.statistics._roots import horner, root_within, with_slope
from aleator.statistics._statistic import root

T = TypeVar("T")

# Of a search for a quantile: most steps, and the error of the normal score at which it ends; the last step, which
# carries the derivative, squares the error.
_MOST_STEPS, _CLOSE, _NARROW = 100, 1e-8, 1e-13
# Paths of more entries than this take fewer lines than a single number.
_SINGLE = 4

_NODES, _WEIGHTS = (np.asarray(each) / 2 for each in np.polynomial.legendre.leggauss(3))
_NODES = _NODES + 0.5


class Crossings(NamedTuple):
    """Where an output crosses a threshold, without derivatives.

    - `fractions`: the probability below the threshold on each line; `below`: of all; `density`: of the output there;
    - `line`, `cell`, `along`: of each crossing, in standard deviations; `densities`: of the output there on its line,
      zero for places without a crossing;
    - `start`, `length`: the part of the cell that is below the threshold.
    """

    fractions: Float[Array, " lines"]
    below: Float[Array, ""]
    density: Float[Array, ""]
    line: Int[Array, " crossings"]
    cell: Int[Array, " crossings"]
    along: Float[Array, " crossings"]
    densities: Float[Array, " crossings"]
    start: Float[Array, " crossings"]
    length: Float[Array, " crossings"]


@final
class TailDistribution(Module):
    """What lies below a threshold: of an output, or of its negative.

    - `signed`: the coefficients of the output or of its negative; `tail`: its lines;
    - `ends`, `heights`: places in each cell between which the output rises or falls, and its values there;
    - `masses`: the probability of each such interval on its line.
    """

    signed: Float[Array, " terms"]
    tail: LowerTail
    ends: Float[Array, "3 lines cells"]
    heights: Float[Array, "3 lines cells"]
    masses: Float[Array, "2 lines cells"]

    def crossings(self, threshold: Float[Array, ""], lines: Lines) -> Crossings:
        """The crossings of a threshold. Not differentiable."""
        is_below = self.heights < threshold
        low, high = is_below[:-1], is_below[1:]
        _, count, cells = self.heights.shape
        (intervals,) = jnp.nonzero((low != high).ravel(), size=lines.orders * count, fill_value=low.size)
        at = jnp.minimum(intervals, low.size - 1)
        cell, line = at % cells, (at // cells) % count
        left, right = (side.ravel()[at] for side in (self.ends[:-1], self.ends[1:]))
        is_falling = high.ravel()[at]
        cubic = self.tail.cubics[:, line, cell].at[0].add(-threshold)
        place = root_within(cubic, left[None], right[None], ~is_falling[None], (left + right)[None] / 2)[0]
        start, end = jnp.where(is_falling, place, left), jnp.where(is_falling, right, place)
        first = lines.first_of(cell)
        along = first + place * lines.step
        parts = _mass(first + start * lines.step, first + end * lines.step)
        is_crossing = intervals < low.size
        whole = jnp.sum(jnp.where(low & high, self.masses, 0.0), axis=(0, 2))
        slope = jnp.abs(with_slope(cubic, place[None])[1][0]) / lines.step
        regular = is_crossing & (slope > 0)
        densities = jnp.where(regular, _normal(along) / jnp.where(regular, slope, 1.0), 0.0)
        fractions = whole + jax.ops.segment_sum(jnp.where(is_crossing, parts, 0.0), line, count)
        weights = self.tail.weights.ravel() / len(self.tail.weights)
        return Crossings(
            fractions=fractions,
            below=weights @ fractions,
            density=weights[line] @ densities,
            line=line,
            cell=cell,
            along=along,
            densities=densities,
            start=start,
            length=jnp.where(is_crossing, end - start, 0.0),
        )

    def below(self, threshold: Float[Array, ""], at: Crossings, lines: Lines) -> Float[Array, ""]:
        """The probability below a threshold. Its derivative is that of the crossings times the density there."""
        points = self.tail.points[:, at.line] + jnp.outer(self.tail.direction, at.along)
        heights = lines.values(self.signed, points) - threshold
        change = heights - jax.lax.stop_gradient(heights)
        weights = self.tail.weights.ravel()
        replicates = len(self.tail.weights)
        return (weights @ at.fractions - (weights[at.line] * at.densities) @ change) / replicates

    def shortfall(self, threshold: Float[Array, ""], at: Crossings, lines: Lines) -> Float[Array, ""]:
        """The expected shortfall below a threshold, zero for values above it.

        It is zero at the crossings, so that their movement does not contribute to its derivative.
        """
        is_below = jax.lax.stop_gradient(self.heights < threshold)
        inside = jnp.where(is_below[:-1] & is_below[1:], self.ends[1:] - self.ends[:-1], 0.0)
        everywhere = lines.first_of(jnp.arange(self.heights.shape[2]))[None, None]
        cubics, weights = self.tail.cubics, self.tail.weights.ravel()
        whole = _shortfall(cubics, self.ends[:-1], inside, everywhere, threshold, lines.step)
        own = cubics[:, at.line, at.cell]
        parts = _shortfall(own, at.start[None], at.length[None], lines.first_of(at.cell)[None], threshold, lines.step)[
            0
        ]
        return (weights @ jnp.sum(whole, axis=(0, 2)) + weights[at.line] @ parts) / len(self.tail.weights)


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


def _tail_distribution(signed: Float[Array, " terms"], lines: Lines) -> TailDistribution:
    tail = lines.lower_tail(signed)
    fixed = jax.lax.stop_gradient(tail.cubics)
    _, slope, bend, rest = fixed
    # A cubic between ends with slopes of different signs has one extremum there.
    turns = slope * (slope + 2 * bend + 3 * rest) < 0
    radicand = root(bend**2 - 3 * rest * slope)
    larger = -(bend + jnp.where(bend < 0, -1.0, 1.0) * radicand)
    near, far = _ratio(slope, larger), _ratio(larger, 3 * rest)
    middle = jnp.where(turns, jnp.clip(jnp.where((near > 0) & (near < 1), near, far), 0.0, 1.0), 1.0)
    ends = jnp.stack([0 * middle, middle, 1 + 0 * middle])
    along = lines.first_of(jnp.arange(ends.shape[2]))[None, None] + ends * lines.step
    return TailDistribution(signed, tail, ends, horner(fixed, ends), _mass(along[:-1], along[1:]))


def _ratio(above: Array, below: Array) -> Array:
    return jnp.where(below == 0, 2.0, above / jnp.where(below == 0, 1.0, below))


def _normal(at: Array) -> Array:
    return jnp.exp(-(at**2) / 2) / math.sqrt(2 * math.pi)


def _mass(low: Array, high: Array) -> Array:
    """The probability of a normal variable between two numbers, without loss of digits in the upper tail."""
    flip = low > 0
    low, high = jnp.where(flip, low, -high), jnp.where(flip, high, -low)
    return (jax.lax.erfc(low / math.sqrt(2)) - jax.lax.erfc(high / math.sqrt(2))) / 2


def _score(probability: Scalar) -> Array:
    """The normal quantile of a probability."""
    return math.sqrt(2) * jax.lax.erf_inv(2 * jnp.asarray(probability) - 1)


@final
class OutputDistribution(Module):
    """The distribution of an output: its mean and spread, and both of its tails, the upper one as that of its negative.

    Thresholds are distances from the mean.
    """

    mean: Float[Array, ""]
    std: Float[Array, ""]
    tails: TailDistribution
    lines: Lines

    def crossings(self, threshold: Float[Array, ""]) -> Crossings:
        """The crossings in both tails: of the output below a threshold, and of its negative below the negative."""
        fixed, threshold = jax.lax.stop_gradient((self, threshold))
        return jax.vmap(TailDistribution.crossings, (0, 0, None))(
            fixed.tails, jnp.stack([threshold, -threshold]), self.lines
        )

    def sides(self, threshold: Float[Array, ""], at: Crossings) -> Float[Array, "2"]:
        """The probabilities below and above a threshold, each by the lines of its tail."""
        return jax.vmap(TailDistribution.below, (0, 0, 0, None))(
            self.tails, jnp.stack([threshold, -threshold]), at, self.lines
        )

    def below(self, threshold: Float[Array, ""]) -> Float[Array, ""]:
        """The probability of less than the mean plus a threshold."""
        return _share(self.sides(threshold, self.crossings(threshold)))

    def above(self, threshold: Float[Array, ""]) -> Float[Array, ""]:
        """The probability of more than the mean plus a threshold, without loss of digits where it is small."""
        return _share(self.sides(threshold, self.crossings(threshold))[::-1])

    def density(self, threshold: Float[Array, ""]) -> Float[Array, ""]:
        """The probability density at the mean plus a threshold. Not differentiable."""
        return _density(self.crossings(threshold))

    def error(self, threshold: Float[Array, ""]) -> Float[Array, ""]:
        """The 95 % half-width of `below` and `above`, by the scatter of the replicates.

        All of them together are more accurate than that, as parts of one net. Zero where one line is exact.
        """
        weights = self.tails.tail.weights
        replicates = weights.shape[1]
        if replicates == 1:
            return jnp.zeros(())
        fractions = self.crossings(threshold).fractions.reshape(weights.shape)
        each = _share(jnp.sum(weights * fractions, axis=2))
        covers = float(scipy.special.stdtrit(replicates - 1, 0.975)) / math.sqrt(replicates)
        return covers * jnp.std(each, ddof=1)

    def quantile(self, level: Scalar) -> Float[Array, ""]:
        """How far the quantile lies from the mean."""
        return self._quantile(level)[0]

    def mean_beyond(self, level: Scalar, *, lower: bool) -> Float[Array, ""]:
        """How far the mean of the values beyond a quantile lies from that of all, in the lower or the upper tail."""
        quantile, sides, at = self._quantile(level)
        side, sign = (0, 1.0) if lower else (1, -1.0)
        tail, own = jax.tree.map(lambda leaf: leaf[side], (self.tails, at))
        # What the integral finds beyond the quantile, which is the level but for its error.
        total = jnp.sum(sides)
        beyond = (level if lower else 1 - level) * jnp.where(total > 0, total, 1.0)
        return quantile - sign * tail.shortfall(sign * quantile, own, self.lines) / beyond

    def _quantile(self, level: Scalar) -> tuple[Array, Float[Array, "2"], Crossings]:
        """The quantile by the implicit function theorem, the probabilities of both sides, and the crossings."""
        fixed = jax.lax.stop_gradient(self)
        end = jax.lax.stop_gradient(fixed._searched(jax.lax.stop_gradient(level)))
        density, sides = _density(end.crossings), self.sides(end.last, end.crossings)
        step = (_share(sides) - level) / jnp.where(density > 0, density, 1.0)
        return end.last - jnp.where(density > 0, step, 0.0), sides, end.crossings

    def _searched(self, level: Scalar) -> "_Search":
        """Newton's method on the normal scale, on which most distribution functions are nearly straight.

        Bisection where a step leaves the bracket or does not halve the error: near an extremum of the output the
        density is without bound, and steps are short far from the quantile. The first bracket is that of Cantelli's
        inequality.
        """
        target, reach = _score(level), 1.01 * self.std
        low, high = -reach * jnp.sqrt((1 - level) / level), reach * jnp.sqrt(level / (1 - level))

        def unfinished(state: _Search) -> Bool[Array, ""]:
            is_wide = state.high - state.low > _NARROW * self.std
            return (jnp.abs(state.off) > _CLOSE) & is_wide & (state.steps < _MOST_STEPS)

        def narrow(state: _Search) -> _Search:
            at = state.following
            crossings = self.crossings(at)
            probability, density = _share(crossings.below), _density(crossings)
            is_low = probability < level
            low, high = jnp.where(is_low, at, state.low), jnp.where(is_low, state.high, at)
            score = _score(probability)
            off = jnp.where(jnp.isfinite(score), score - target, jnp.inf)
            newton = at - off * _normal(score) / density
            usable = (newton > low) & (newton < high) & (jnp.abs(off) <= jnp.abs(state.off) / 2)
            following = jnp.where(usable, newton, (low + high) / 2)
            return _Search(low, high, following, at, off, crossings, state.steps + 1)

        start = jnp.clip(self.std * target, low, high)
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(self.crossings, start))
        first = _Search(low, high, start, start, jnp.asarray(jnp.inf), nothing, jnp.zeros((), int))
        return jax.lax.while_loop(unfinished, narrow, first)


class _Search(NamedTuple):
    """The state of the search for a quantile: a bracket, the thresholds to come and last, how far the normal score of
    the last one is off, and its crossings.
    """

    low: Float[Array, ""]
    high: Float[Array, ""]
    following: Float[Array, ""]
    last: Float[Array, ""]
    off: Float[Array, ""]
    crossings: Crossings
    steps: Int[Array, ""]


def _share(sides: Float[Array, "2 *replicates"]) -> Float[Array, "*replicates"]:
    """The distribution function, from the probabilities below and above a threshold."""
    total = sides[0] + sides[1]
    return sides[0] / jnp.where(total > 0, total, 1.0)


def _density(at: Crossings) -> Float[Array, ""]:
    """The derivative of `_share` by the threshold."""
    return at.below[::-1] @ at.density / jnp.maximum(jnp.sum(at.below), np.finfo(float).tiny) ** 2


def by_lines(
    of_distribution: Callable[[T, OutputDistribution], Array],
    numbers: T,
    coefficients: Float[Array, "terms *shape"],
    lines: Lines,
    sharing: int = 1,
) -> Float[Array, "..."]:
    """A function of the distributions of entries, with these along its first axis.

    A single number uses all prepared lines; the more entries a path has, the fewer each uses.

    - `numbers`: what the function is given besides, a tree of arrays of the entries' shape; `sharing`: so many paths
      are in one array of coefficients.
    """
    leaves, structure = jax.tree.flatten(numbers)
    shape, terms = coefficients.shape[1:], len(coefficients)
    entries = math.prod(shape) // sharing
    lines = lines if entries <= _SINGLE else lines.fewer(max(1, _SINGLE * REPLICATES // entries))

    def of_row(row: Float[Array, " columns"]) -> Array:
        return of_distribution(
            jax.tree.unflatten(structure, list(row[terms:])), output_distribution(row[:terms], lines)
        )

    # The numbers of an entry follow its coefficients.
    rows = jnp.concatenate([coefficients, *(leaf[None] for leaf in leaves)]).reshape(terms + len(leaves), -1).T
    values = of_row(rows[0])[None] if len(rows) == 1 else jax.lax.map(of_row, rows)
    return values.reshape(*shape, *values.shape[1:])


def output_distribution(coefficients: Float[Array, " terms"], lines: Lines) -> OutputDistribution:
    """The distribution of an output."""
    varying = coefficients.at[0].set(0.0)
    tails = jax.vmap(lambda sign: _tail_distribution(sign * varying, lines))(jnp.array([1.0, -1.0]))
    return OutputDistribution(coefficients[0], root(jnp.sum(varying**2)), tails, lines)
