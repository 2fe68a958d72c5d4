"""The distributions of some outputs, from their expansions along lines through the germ space (see `_lines`).

First derivatives are exact. Second derivatives are not available, because the search for crossings has none.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import Scalar
from aleator._core.leaves import Module
from aleator.statistics._lines import LineDistribution, Lines
from aleator.statistics._statistic import in_blocks, root

T = TypeVar("T")

# Most steps in the search for a quantile; four are usual.
_MOST_STEPS = 60

# Tolerance of the search in standard deviations; the last step, which carries the derivative, squares the error.
_CLOSE = 1e-8

# Entries times lines: at most so many at once, for the cache, and so many in all, for time.
_AT_ONCE = 2**12
_IN_ALL = 2**19
_FEWEST = 64

# Newton's method within a bracket, bisection where a step leaves it. It ends when the last root moves by no more than
# this, after which the error of a simple root, which a step squares, is rounding.
_MOST_ITERATIONS, _AT_REST = 30, 1e-9
# At a root, rounding may put a value and a step on different sides. A step that leaves the bracket by less than this
# part of it, or by rounding, ends at its edge: bisection would lose the digits found so far.
_AT_THE_EDGE, _ROUNDING = 1e-6, 1e-14


@final
class OutputDistribution(Module):
    """Some outputs along lines, in arrays of one loop: a vectorised loop over each would copy its state in every step.

    - `mean`, `std`: of their expansions;
    - `series`, `powers`: how each differs from its mean along each line, in orthonormal polynomials and in powers of
      the line's variable, which goes from -1 to 1;
    - `edges`: between which it rises or falls along a line; `heights`: how it differs from its mean there;
    - `edge_levels`: the distribution function there;
    - `weights`: of each line.
    """

    mean: Float[Array, " entries"]
    std: Float[Array, " entries"]
    series: Float[Array, "orders entries directions lines"]
    powers: Float[Array, "orders entries directions lines"]
    edges: Float[Array, "edges entries directions lines"]
    heights: Float[Array, "edges entries directions lines"]
    edge_levels: Float[Array, "edges entries directions lines"]
    weights: Float[Array, "entries directions"]
    distribution: LineDistribution

    def below(self, threshold: Float[Array, " entries"]) -> Float[Array, " entries"]:
        """The probability of less than the mean plus `threshold`."""
        return self._probability(threshold, self._part_below(threshold))

    def _part_below(self, threshold: Array, start: Array | None = None) -> "_Part":
        """The part of each line below a threshold, without derivatives; `start`: guesses of its crossings."""
        fixed, threshold = jax.lax.stop_gradient((self, threshold))
        crossings = fixed._crossings(threshold, start)
        levels, densities = fixed.distribution.level_and_density(crossings)
        below = jnp.sum(_differences(fixed.edge_levels, levels, fixed._rising), axis=0)
        return _Part(crossings, fixed._of_output(densities, crossings), jnp.mean(below, axis=2))

    def _probability(self, threshold: Array, part: "_Part") -> Float[Array, " entries"]:
        """The probability of less than the mean plus a threshold."""
        # Its derivative is that of the crossings times the density there, so that no table is differentiated.
        heights = horner(self._beyond(threshold), part.crossings)
        change = heights - jax.lax.stop_gradient(heights)
        return jnp.sum(self.weights * (part.below - jnp.mean(jnp.sum(part.densities * change, axis=0), axis=2)), axis=1)

    def density(self, threshold: Float[Array, " entries"]) -> Float[Array, " entries"]:
        """The probability density at the mean plus `threshold`."""
        crossings = self._crossings(threshold)
        # The crossings with their derivatives, by the implicit function theorem.
        heights, slopes = horner(self._beyond(threshold), crossings), slope(self.powers, crossings)
        regular = self._is_inside(crossings) & (slopes != 0)
        step = jnp.where(regular, heights / jnp.where(regular, jax.lax.stop_gradient(slopes), 1.0), 0.0)
        moved = crossings - step
        densities = self.distribution.level_and_density(moved)[1]
        return self._average(jnp.sum(self._of_output(densities, moved), axis=0))

    def excess(self, threshold: Float[Array, " entries"]) -> Float[Array, " entries"]:
        """The expected excess over the mean plus `threshold`, zero for values below it."""
        below = self._all_below(threshold)
        above = jnp.eye(len(below))[:, 0, None, None, None] - below
        return self._average(jnp.sum(self.series * above, axis=0) - _across(threshold) * above[0])

    def shortfall(self, threshold: Float[Array, " entries"]) -> Float[Array, " entries"]:
        """The expected shortfall below the mean plus `threshold`, zero for values above it."""
        below = self._all_below(threshold)
        return self._average(_across(threshold) * below[0] - jnp.sum(self.series * below, axis=0))

    def _all_below(self, threshold: Array) -> Float[Array, "orders entries directions lines"]:
        """The partial moments of each line's distribution over the part where the output is below the threshold."""
        # The excess is zero at the crossings, so that their movement does not contribute to the derivative.
        crossings = self._crossings(threshold)
        at_edges, at_crossings = (
            self.distribution.partial_moments(x, len(self.series)) for x in (self.edges, crossings)
        )
        return jnp.moveaxis(jnp.sum(_differences(at_edges, at_crossings, self._rising[..., None]), axis=0), -1, 0)

    def quantile(self, level: Scalar) -> Float[Array, " entries"]:
        """How far the quantile lies from the mean, by the implicit function theorem."""
        end = self._search(level)
        probability = self._probability(end.at, end.part)
        density = jax.lax.stop_gradient(self)._average(jnp.sum(end.part.densities, axis=0))
        regular = density > 0
        return end.at - jnp.where(regular, (probability - level) / jnp.where(regular, density, 1.0), 0.0)

    def nearly_quantile(self, level: Scalar) -> Float[Array, " entries"]:
        """The quantile to 1e-8 standard deviations, without derivatives."""
        return self._search(level).at

    def _search(self, level: Scalar) -> "_Search":
        return jax.lax.stop_gradient(jax.lax.stop_gradient(self)._searched(jax.lax.stop_gradient(level)))

    def _searched(self, level: Scalar) -> "_Search":
        """Newton's method on the normal scale, on which most distribution functions are nearly straight.

        Bisection where a step leaves the bracket; the first bracket is that of Cantelli's inequality.
        """
        target = jax.scipy.special.ndtri(level)
        reach = 1.01 * self.std
        low, high = -reach * jnp.sqrt((1 - level) / level), reach * jnp.sqrt(level / (1 - level))

        def unfinished(state: _Search) -> Bool[Array, ""]:
            return ~jnp.all(state.done) & (state.steps < _MOST_STEPS)

        def narrow(state: _Search) -> _Search:
            at = state.at + state.step
            # Thresholds move little, and crossings with them.
            part = self._part_below(at, state.part.crossings)
            probability = jnp.sum(self.weights * part.below, axis=1)
            density = self._average(jnp.sum(part.densities, axis=0))
            low, high = jnp.where(probability < level, at, state.low), jnp.where(probability < level, state.high, at)
            inside = (probability > 0) & (probability < 1)
            score = jax.scipy.special.ndtri(jnp.where(inside, probability, 0.5))
            pace = density / jax.scipy.stats.norm.pdf(score)
            newton = at - (score - target) / jnp.where(pace > 0, pace, 1.0)
            usable = inside & (pace > 0) & (newton >= low) & (newton <= high)
            following = jnp.where(usable, newton, (low + high) / 2)
            # The last pass is at the end of a small step. One more would move an entry by rounding, or bisect.
            done = state.done | ~((jnp.abs(state.step) > _CLOSE * self.std) & (high > low))
            step = jnp.where(done, 0.0, following - at)
            return _Search(low, high, at, step, part, done, state.steps + 1)

        start = jnp.clip(self.std * target, low, high)
        guess = secants(self.edges, self.heights - _across(start)[None])
        nothing = _Part(guess, guess, self.weights)
        first = _Search(
            low, high, start - self.std, self.std, nothing, jnp.zeros(self.std.shape, bool), jnp.zeros((), int)
        )
        return jax.lax.while_loop(unfinished, narrow, first)

    def _crossings(self, threshold: Array, start: Array | None = None) -> Float[Array, "intervals *lines"]:
        """Crossings of a threshold between neighbouring edges, without derivatives."""
        fixed, threshold = jax.lax.stop_gradient((self, threshold))
        return roots_between(fixed._beyond(threshold), fixed.edges, fixed.heights - _across(threshold)[None], start)

    def _beyond(self, threshold: Array) -> Float[Array, "orders *lines"]:
        """The polynomials less a threshold."""
        return self.powers.at[0].add(-_across(threshold))

    @property
    def _rising(self) -> Bool[Array, "intervals *lines"]:
        return self.heights[1:] >= self.heights[:-1]

    def _is_inside(self, crossings: Float[Array, "intervals *lines"]) -> Bool[Array, "intervals *lines"]:
        """Whether there is a crossing: if there is none, the root was set to an edge."""
        return (crossings > self.edges[:-1]) & (crossings < self.edges[1:])

    def _of_output(self, densities: Array, crossings: Array) -> Float[Array, "intervals *lines"]:
        """The probability density of the output that each crossing contributes, from that of the line's variable."""
        slopes = jnp.abs(slope(self.powers, crossings))
        regular = self._is_inside(jax.lax.stop_gradient(crossings)) & (slopes > 0)
        return jnp.where(regular, densities / jnp.where(regular, slopes, 1.0), 0.0)

    def _average(self, of_lines: Float[Array, "entries directions lines"]) -> Float[Array, " entries"]:
        return jnp.sum(self.weights * jnp.mean(of_lines, axis=2), axis=1)


class _Part(NamedTuple):
    """The part of each line below a threshold.

    - `crossings`: of the threshold; `densities`: of the output there; `below`: the mean probability below it.
    """

    crossings: Float[Array, "intervals entries directions lines"]
    densities: Float[Array, "intervals entries directions lines"]
    below: Float[Array, "entries directions"]


class _Search(NamedTuple):
    """The state of the search for quantiles: brackets, thresholds, their next steps, and the parts below them."""

    low: Float[Array, " entries"]
    high: Float[Array, " entries"]
    at: Float[Array, " entries"]
    step: Float[Array, " entries"]
    part: _Part
    done: Bool[Array, " entries"]
    steps: Int[Array, ""]


def _across(threshold: Float[Array, " entries"]) -> Float[Array, "entries 1 1"]:
    return jnp.asarray(threshold)[..., None, None]


def _differences(
    at_edges: Float[Array, "edges ..."],
    at_crossings: Float[Array, "intervals ..."],
    rising: Bool[Array, "intervals ..."],
) -> Float[Array, "intervals ..."]:
    """The increase of a distribution function over the part of each interval in which the output is below."""
    return jnp.where(rising, at_crossings - at_edges[:-1], at_edges[1:] - at_crossings)


def by_lines(
    of_distribution: Callable[[T, OutputDistribution], Array],
    numbers: T,
    coefficients: Float[Array, "terms *shape"],
    lines: Lines,
    sharing: int = 1,
) -> Float[Array, "..."]:
    """A function of the distributions of entries, with these along its first axis.

    A single number uses all prepared lines. The more entries a path has, the fewer lines each uses, but at least 64 in
    each direction.

    - `numbers`: what the function is given besides, a tree of arrays of the entries' shape; `sharing`: so many paths
      are in one array of coefficients.
    """
    leaves, structure = jax.tree.flatten(numbers)
    entries, directions = math.prod(coefficients.shape[1:]) // sharing, len(lines.preference)
    share = max(_IN_ALL // (max(entries, 1) * directions), _FEWEST)
    count = min(lines.count, 2 ** int(math.log2(share)))
    together = max(1, _AT_ONCE // (count * directions))
    terms = len(coefficients)

    def of_rows(rows: Float[Array, "entries columns"]) -> Array:
        own = jax.tree.unflatten(structure, list(rows[:, terms:].T))
        return of_distribution(own, output_distribution(rows[:, :terms], lines, count))

    # The numbers of an entry follow its coefficients.
    return in_blocks(of_rows, jnp.concatenate([coefficients, *(leaf[None] for leaf in leaves)]), together)


def output_distribution(coefficients: Float[Array, "entries terms"], lines: Lines, count: int) -> OutputDistribution:
    """The distributions of some outputs, by up to `count` lines in each direction."""
    varying = coefficients.at[:, 0].set(0.0)
    series = jax.vmap(lambda terms: lines.polynomials(terms, count), out_axes=1)(varying)
    powers = jnp.einsum("vkm,kevn->mevn", lines.distribution.monomials, series)
    fixed = jax.lax.stop_gradient(powers)
    edges = extrema(fixed)
    return OutputDistribution(
        mean=coefficients[:, 0],
        std=root(jnp.sum(varying**2, axis=1)),
        series=series,
        powers=powers,
        edges=edges,
        heights=horner(fixed, edges),
        edge_levels=lines.distribution.level_and_density(edges)[0],
        weights=jax.vmap(lines.weights)(varying),
        distribution=lines.distribution,
    )


def extrema(powers: Float[Array, "orders *lines"]) -> Float[Array, "edges *lines"]:
    """The edges between which each polynomial is monotone: -1, its extrema, 1.

    The extrema are the roots of the derivative, found in the same way from those of the second derivative, and so on,
    down to a quadratic one. Between neighbouring edges a polynomial has at most one root, which bisection cannot miss:
    unlike a search on a grid, this misses none.

    Polynomials are given by their coefficients of `x^0, x^1, ...`. If one has fewer extrema, edges coincide.
    """
    degree = len(powers) - 1
    end = jnp.ones((1, *powers.shape[1:]))
    inner = _lowest(_derivative(powers, max(degree - 2, 1))) if degree > 1 else end[:0]
    edges = jnp.concatenate([-end, inner, end])
    for order in range(degree - 3, 0, -1):
        slopes = _derivative(powers, order)
        edges = jnp.concatenate([-end, roots_between(slopes, edges, horner(slopes, edges)), end])
    return edges


def _lowest(powers: Float[Array, "orders *lines"]) -> Float[Array, "roots *lines"]:
    """The roots of polynomials of degree one or two in rising order: 1 for those that are not real, none beyond ±1."""
    constant, linear = powers[:2]
    if len(powers) == 2:
        return jnp.clip(_ratio(-constant, linear), -1.0, 1.0)[None]
    # One of the two by its sum with the other would lose digits.
    radicand = linear**2 - 4 * powers[2] * constant
    half = -(linear + jnp.where(linear < 0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(radicand, 0.0))) / 2
    first, second = (
        jnp.where(radicand < 0, 1.0, jnp.clip(root, -1.0, 1.0))
        for root in (_ratio(half, powers[2]), _ratio(constant, half))
    )
    return jnp.stack([jnp.minimum(first, second), jnp.maximum(first, second)])


def _ratio(above: Array, below: Array) -> Array:
    return jnp.where(below == 0, 1.0, above / jnp.where(below == 0, 1.0, below))


def roots_between(
    powers: Float[Array, "orders *lines"],
    edges: Float[Array, "edges *lines"],
    values: Float[Array, "edges *lines"],
    start: Float[Array, "intervals *lines"] | None = None,
) -> Float[Array, "intervals *lines"]:
    """The root between each pair of neighbouring edges, at which the polynomials have known values.

    Where there is no root, it is the edge at which the value is nearest to zero. The search begins at `start`, or where
    straight lines between the edges have their roots.
    """
    low, high = edges[:-1], edges[1:]
    rising = values[1:] >= values[:-1]
    is_below = jnp.maximum(values[:-1], values[1:]) <= 0
    is_above = (jnp.minimum(values[:-1], values[1:]) >= 0) & ~is_below
    # A bracket without a root is empty.
    at_low, at_high = jnp.where(rising, is_above, is_below), jnp.where(rising, is_below, is_above)
    low, high = jnp.where(at_high, high, low), jnp.where(at_low, low, high)

    def is_moving(state: tuple[Array, ...]) -> Bool[Array, ""]:
        *_, moving, count = state
        return moving & (count < _MOST_ITERATIONS)

    def narrow(state: tuple[Array, ...]) -> tuple[Array, ...]:
        low, high, x, _, count = state
        value, slope = _with_slope(powers, x)
        below = (value < 0) == rising
        low, high = jnp.where(below, x, low), jnp.where(below, high, x)
        newton = x - value / jnp.where(slope == 0, 1.0, slope)
        edge = _AT_THE_EDGE * (high - low) + _ROUNDING
        usable = (newton >= low - edge) & (newton <= high + edge) & (slope != 0)
        closer = jnp.where(usable, jnp.clip(newton, low, high), (low + high) / 2)
        return low, high, closer, jnp.any(jnp.abs(closer - x) > _AT_REST), count + 1

    x = jnp.clip(secants(edges, values) if start is None else start, low, high)
    return jax.lax.while_loop(is_moving, narrow, (low, high, x, jnp.array(True), jnp.zeros((), int)))[2]


def secants(
    edges: Float[Array, "edges *lines"], values: Float[Array, "edges *lines"]
) -> Float[Array, "intervals *lines"]:
    """The roots of the straight lines between neighbouring edges, at which polynomials have some values."""
    rise = values[1:] - values[:-1]
    return edges[:-1] - values[:-1] * (edges[1:] - edges[:-1]) / jnp.where(rise == 0, 1.0, rise)


def horner(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> Float[Array, "points *lines"]:
    """The values of polynomials, each at its own points."""
    value = jnp.zeros(x.shape)
    for coefficient in powers[::-1]:
        value = value * x + coefficient[None]
    return value


def slope(powers: Float[Array, "orders *lines"], x: Float[Array, "points *lines"]) -> Float[Array, "points *lines"]:
    """The first derivatives of polynomials, each at its own points."""
    return _with_slope(powers, x)[1]


def _with_slope(powers: Array, x: Array) -> tuple[Array, Array]:
    value, slope = jnp.zeros(x.shape), jnp.zeros(x.shape)
    for coefficient in powers[::-1]:
        slope = slope * x + value
        value = value * x + coefficient[None]
    return value, slope


def _derivative(powers: Float[Array, "orders *lines"], order: int) -> Float[Array, "fewer *lines"]:
    """The coefficients of a derivative, up to a common factor."""
    exponents = np.arange(order, len(powers))
    factors = np.ones(len(exponents))
    for step in range(order):
        factors *= (exponents - step) / (order - step)
    return powers[order:] * jnp.asarray(factors).reshape(-1, *[1] * (powers.ndim - 1))
