"""The distribution of one output, from its expansion along lines through the germ space (see `_lines`).

First derivatives are exact. Second derivatives are not available, because the search for crossings has none.
"""

import math
from collections.abc import Callable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import Scalar
from aleator.statistics._crossings import bracketed_roots, extrema, horner, slope
from aleator.statistics._line_distribution import LineDistribution
from aleator.statistics._lines import Lines
from aleator.statistics._moments import root
from aleator.statistics._statistic import entry_by_entry

# Most steps in the search for a quantile; four are usual.
_MOST_STEPS = 60

# Tolerance of the search in standard deviations; the last step, which carries the derivative, squares the error.
_CLOSE = 1e-8

# Entries times lines: at most so many at once, for memory, and so many in all, for time.
_AT_ONCE = 2**14
_IN_ALL = 2**19
_FEWEST = 64


@final
class OutputDistribution(eqx.Module):
    """One output along lines.

    - `mean`, `std`: of its expansion;
    - `series`, `powers`: how it differs from the mean along each line, in orthonormal polynomials and in powers of the
      line's variable, which goes from -1 to 1;
    - `edges`: between which it rises or falls along a line; `edge_levels`: the distribution function there;
    - `weights`: of each line.
    """

    mean: Float[Array, ""]
    std: Float[Array, ""]
    series: Float[Array, "orders directions lines"]
    powers: Float[Array, "orders directions lines"]
    edges: Float[Array, "edges directions lines"]
    edge_levels: Float[Array, "edges directions lines"]
    weights: Float[Array, " directions"]
    distribution: LineDistribution

    def below(self, threshold: Scalar) -> Float[Array, ""]:
        """The probability of less than the mean plus `threshold`."""
        return self._below(threshold, *self._crossings(threshold))

    def _below(self, threshold: Scalar, crossings: Array, rising: Array) -> Float[Array, ""]:
        levels = self.distribution.partial_moments(crossings, 1)[..., 0]
        below = jnp.sum(_differences(self.edge_levels, levels, rising), axis=0)
        # Its derivative is that of the crossings times the density there, so that no table is differentiated.
        heights = horner(self.powers.at[0].add(-threshold), crossings)
        change = heights - jax.lax.stop_gradient(heights)
        return self._average(below - jnp.sum(jax.lax.stop_gradient(self._densities(crossings)) * change, axis=0))

    def density(self, threshold: Scalar) -> Float[Array, ""]:
        """The probability density at the mean plus `threshold`."""
        crossings, _ = self._crossings(threshold)
        # The crossings with their derivatives, by the implicit function theorem.
        heights, slopes = horner(self.powers.at[0].add(-threshold), crossings), slope(self.powers, crossings)
        regular = self._is_inside(crossings) & (slopes != 0)
        step = jnp.where(regular, heights / jnp.where(regular, jax.lax.stop_gradient(slopes), 1.0), 0.0)
        return self._average(jnp.sum(self._densities(crossings - step), axis=0))

    def excess(self, threshold: Scalar) -> Float[Array, ""]:
        """The expected excess over the mean plus `threshold`, zero for values below it."""
        below = self._all_below(threshold)
        orders = jnp.arange(len(below))[:, None, None]
        above = jnp.where(orders == 0, 1.0, 0.0) - below
        return self._average(jnp.sum(self.series * above, axis=0) - jnp.asarray(threshold) * above[0])

    def shortfall(self, threshold: Scalar) -> Float[Array, ""]:
        """The expected shortfall below the mean plus `threshold`, zero for values above it."""
        below = self._all_below(threshold)
        return self._average(jnp.asarray(threshold) * below[0] - jnp.sum(self.series * below, axis=0))

    def _all_below(self, threshold: Scalar) -> Float[Array, "orders directions lines"]:
        """The partial moments of each line's distribution over the part where the output is below the threshold."""
        # The excess is zero at the crossings, so that their movement does not contribute to the derivative.
        crossings, rising = self._crossings(threshold)
        at_edges, at_crossings = (
            self.distribution.partial_moments(x, len(self.series)) for x in (self.edges, crossings)
        )
        return jnp.moveaxis(jnp.sum(_differences(at_edges, at_crossings, rising[..., None]), axis=0), -1, 0)

    def quantile(self, level: Scalar) -> Float[Array, ""]:
        """How far the quantile lies from the mean, by the implicit function theorem."""
        found = self.nearly_quantile(level)
        crossings, rising = self._crossings(found)
        probability = self._below(found, crossings, rising)
        density = jax.lax.stop_gradient(self._average(jnp.sum(self._densities(crossings), axis=0)))
        regular = density > 0
        return found - jnp.where(regular, (probability - level) / jnp.where(regular, density, 1.0), 0.0)

    def nearly_quantile(self, level: Scalar) -> Float[Array, ""]:
        """The quantile to 1e-8 standard deviations, without derivatives."""
        return jax.lax.stop_gradient(self)._quantile(jax.lax.stop_gradient(level))

    def _quantile(self, level: Scalar) -> Float[Array, ""]:
        """Newton's method on the normal scale, on which most distribution functions are nearly straight.

        Bisection where a step leaves the bracket; the first bracket is that of Cantelli's inequality.
        """
        target = jax.scipy.special.ndtri(level)
        reach = 1.01 * self.std
        low, high = -reach * jnp.sqrt((1 - level) / level), reach * jnp.sqrt(level / (1 - level))

        def unfinished(state: tuple) -> Bool[Array, ""]:
            low, high, _, step, count = state
            return (jnp.abs(step) > _CLOSE * self.std) & (high > low) & (count < _MOST_STEPS)

        def narrow(state: tuple) -> tuple:
            low, high, at, _, count = state
            crossings, rising = self._crossings(at)
            probability = self._below(at, crossings, rising)
            density = self._average(jnp.sum(self._densities(crossings), axis=0))
            low, high = jnp.where(probability < level, at, low), jnp.where(probability < level, high, at)
            inside = (probability > 0) & (probability < 1)
            score = jax.scipy.special.ndtri(jnp.where(inside, probability, 0.5))
            pace = density / jax.scipy.stats.norm.pdf(score)
            newton = at - (score - target) / jnp.where(pace > 0, pace, 1.0)
            usable = inside & (pace > 0) & (newton >= low) & (newton <= high)
            following = jnp.where(usable, newton, (low + high) / 2)
            return low, high, following, following - at, count + 1

        start = jnp.clip(self.std * target, low, high)
        return jax.lax.while_loop(unfinished, narrow, (low, high, start, self.std, 0))[2]

    def _crossings(self, threshold: Scalar) -> tuple[Float[Array, "intervals *lines"], Bool[Array, "intervals *lines"]]:
        """Crossings of a threshold between neighbouring edges, without derivatives, and whether the output rises."""
        shifted = self.powers.at[0].add(-threshold)
        return bracketed_roots(jax.lax.stop_gradient(shifted), self.edges)

    def _is_inside(self, crossings: Float[Array, "intervals *lines"]) -> Bool[Array, "intervals *lines"]:
        """Whether there is a crossing: if there is none, the root was set to an edge."""
        return (crossings > self.edges[:-1]) & (crossings < self.edges[1:])

    def _densities(self, crossings: Float[Array, "intervals *lines"]) -> Float[Array, "intervals *lines"]:
        """The probability density of the output that each crossing contributes."""
        slopes = jnp.abs(slope(self.powers, crossings))
        regular = self._is_inside(jax.lax.stop_gradient(crossings)) & (slopes > 0)
        return jnp.where(regular, self.distribution.density(crossings) / jnp.where(regular, slopes, 1.0), 0.0)

    def _average(self, of_lines: Float[Array, "directions lines"]) -> Float[Array, ""]:
        return self.weights @ jnp.mean(of_lines, axis=1)


def _differences(
    at_edges: Float[Array, "edges ..."],
    at_crossings: Float[Array, "intervals ..."],
    rising: Bool[Array, "intervals ..."],
) -> Float[Array, "intervals ..."]:
    """The increase of a distribution function over the part of each interval in which the output is below."""
    return jnp.where(rising, at_crossings - at_edges[:-1], at_edges[1:] - at_crossings)


def by_lines(
    of_distribution: Callable[[OutputDistribution], Array], coefficients: Float[Array, "terms *shape"], lines: Lines
) -> Float[Array, "..."]:
    """A function of the distribution of each entry.

    A single number uses all prepared lines. The more entries a path has, the fewer lines each uses, but at least 64 in
    each direction.
    """
    entries, directions = math.prod(coefficients.shape[1:]), len(lines.preference)
    share = max(_IN_ALL // (max(entries, 1) * directions), _FEWEST)
    count = min(lines.count, 2 ** int(math.log2(share)))
    together = max(1, _AT_ONCE // (count * directions))
    return entry_by_entry(
        lambda terms: of_distribution(output_distribution(terms, lines, count)), coefficients, together
    )


def output_distribution(coefficients: Float[Array, " terms"], lines: Lines, count: int) -> OutputDistribution:
    """The distribution of an output, by up to `count` lines in each direction."""
    series = lines.polynomials(coefficients.at[0].set(0.0), count)
    powers = jnp.einsum("vkm,kvn->mvn", lines.distribution.monomials, series)
    edges = extrema(jax.lax.stop_gradient(powers))
    return OutputDistribution(
        mean=coefficients[0],
        std=root(jnp.sum(coefficients[1:] ** 2)),
        series=series,
        powers=powers,
        edges=edges,
        edge_levels=lines.distribution.partial_moments(edges, 1)[..., 0],
        weights=lines.weights(coefficients.at[0].set(0.0)),
        distribution=lines.distribution,
    )
