"""The lower tail of an output, from the coefficients of its expansion, with derivatives in closed form.

All is NumPy: programs would take seconds to compile for each basis.
"""

import abc
import math
from typing import Any, ClassVar, NamedTuple, final

import jax
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import quietly
from aleator.statistics._cubics import (
    LAST,
    TABLED,
    beyond,
    by_values,
    cubics_through,
    density_of,
    extremum_within,
    horner,
    integrals_of_powers,
    root_within,
    with_slope,
)
from aleator.statistics._lines import CENTRE, STILL, Lines, LinesInElements, placed, unit

# Lines on a lattice that err by this part of a probability touch the threshold: derivatives by it are differences over
# this part of what the probability divided by the density is.
_TOUCHING, _SHELL = 1e-4, 0.15

# The width of a cell of the tables of germ variables, in standard deviations.
_CELL = 2 * LAST / TABLED

# Of a search for a quantile: most steps, and the width of a bracket at which it ends.
_MOST_STEPS, _NARROW = 100, 1e-13
# An element varies by less than this part of the spread: not at all.
_CONSTANT = 1e-9
# Points are evaluated for so many at once, for the cache.
_TOGETHER = 2**11


class Cut(NamedTuple):
    """Where an output crosses a threshold.

    - `below`: the probability below the threshold; `density`: of the output there;
    - `doubt`: the probability of places at which a germ variable all but jumps, so that the crossing may be elsewhere;
    - `elements`: that of each element, if there are any; all else is of lines alone;
    - `inside`: the parts of cells that lie below it as a whole; `fractions`: the probability below it on each line;
    - `line`, `cell`, `along`: of each crossing, in standard deviations; `densities`: of the output there on its line;
    - `start`, `length`: the part of the cell that is below the threshold.
    """

    below: Float[Any, "*n"]
    density: Float[Any, "*n"]
    doubt: float = 0.0
    elements: tuple["Cut", ...] = ()
    inside: Bool[np.ndarray, " parts"] = np.zeros(0, bool)
    fractions: Float[np.ndarray, " lines"] = np.zeros(0)
    line: Int[np.ndarray, " crossings"] = np.zeros(0, int)
    cell: Int[np.ndarray, " crossings"] = np.zeros(0, int)
    along: Float[np.ndarray, " crossings"] = np.zeros(0)
    densities: Float[np.ndarray, " crossings"] = np.zeros(0)
    start: Float[np.ndarray, " crossings"] = np.zeros(0)
    length: Float[np.ndarray, " crossings"] = np.zeros(0)


class Place(NamedTuple):
    """A threshold, and the output there; of a quantile its derivatives by the coefficients and by the level too."""

    threshold: Float[Any, "*n"]
    cut: Cut
    slopes: Float[np.ndarray, "terms *n"] = np.zeros(0)
    by_level: Float[Any, "*n"] = 0.0


class AbstractLowerTail(abc.ABC):
    """What lies below a threshold, of an output with mean zero, or of its negative: of one, or of some entries.

    - `close`: the error of the normal score at which the search for a quantile ends; the last step squares it;
    - `std`: the spread.

    Slopes are derivatives by the coefficients.
    """

    close: ClassVar[float]

    std: Float[Any, "*n"]

    @abc.abstractmethod
    def cut(self, threshold: Float[Any, "*n"]) -> Cut:
        """The output at a threshold."""

    @abc.abstractmethod
    def below(self, threshold: Float[Any, "*n"], at: Cut) -> tuple[Float[Any, "*n"], Float[np.ndarray, "terms *n"]]:
        """The probability below a threshold. Its derivative by the threshold is the density."""

    @abc.abstractmethod
    def shortfall(self, threshold: Float[Any, "*n"], at: Cut) -> tuple[Float[Any, "*n"], Float[np.ndarray, "terms *n"]]:
        """The expected shortfall below a threshold, zero for values above it."""

    @abc.abstractmethod
    def error(self, at: Cut) -> Float[Any, "*n"]:
        """The 95 % half-width of the probability below a threshold."""

    def change(
        self, threshold: Float[Any, "*n"], at: Cut, slopes: Float[np.ndarray, "terms *n"]
    ) -> tuple[Float[Any, "*n"], Float[np.ndarray, "terms *n"]]:
        """The density at a threshold, and the derivatives of the probability below it, from those at its crossings."""
        del threshold
        return at.density, slopes

    @quietly
    def quantile(self, level: float) -> Place:
        """The quantile, by Newton's method on the normal scale, on which most distribution functions are nearly
        straight, and the implicit function theorem.

        Bisection where a step leaves the bracket or does not halve the error: near an extremum of the output the
        density is without bound, and steps are short far from the quantile. The first bracket is that of Cantelli's
        inequality.
        """
        target, reach, odds = scipy.special.ndtri(level), 1.01 * self.std, math.sqrt(level / (1 - level))
        low, high = -reach / odds, reach * odds
        last, off = np.clip(self.std * target, low, high), np.inf
        cut = self.cut(last)
        for _ in range(_MOST_STEPS):
            is_low, score, before = cut.below < level, scipy.special.ndtri(cut.below), np.abs(off)
            low, high = np.where(is_low, last, low), np.where(is_low, high, last)
            off = np.where(np.isfinite(score), score - target, np.inf)
            newton = last - off * density_of(score) / cut.density
            is_usable = (newton > low) & (newton < high) & (np.abs(off) <= before / 2)
            moves = (np.abs(off) > self.close) & (high - low > _NARROW * self.std)
            if not moves.any():
                break
            last = np.where(moves, np.where(is_usable, newton, (low + high) / 2), last)
            cut = self.cut(last)
        value, slopes = self.below(last, cut)
        has_density = self.slope(off, cut) > 0
        density, slopes = self.change(last, cut, slopes)
        by_level = np.where(has_density, 1 / np.where(has_density, density, 1.0), 0.0)
        return Place(last - (value - level) * by_level, cut, -slopes * by_level, by_level)

    def slope(self, off: Float[Any, "*n"], cut: Cut) -> Float[Any, "*n"]:
        """The density at a quantile; zero where it is one of many systems at once."""
        del off
        return cut.density


@final
class TailByLines(AbstractLowerTail):
    """The probability below a threshold as the mean over lines.

    - `line`, `cell`, `left`, `right`: of the parts of cells in which the output rises or falls: all cells up to an
      extremum, or as a whole, and then what follows extrema; `value_left`, `value_right`: its values at their ends;
    - `masses`: the probability of each on its line.
    """

    close: ClassVar[float] = 1e-7

    def __init__(self, signed: Float[np.ndarray, " terms"], lines: Lines, *, is_axial: bool = False):
        """`is_axial`: the lines run along a germ variable, not to where the output is smallest."""
        self.signed, self.lines, self.std = signed, lines, float(np.sqrt(np.sum(signed**2)))
        minima = lines.axis(signed) if is_axial else unit(np.round(lines.minima(signed) / STILL) * STILL)
        self.direction = minima[:, 0]
        self.points, weights = placed(np.asarray(lines.normals), self.direction, CENTRE * minima)
        self.share = weights.ravel() / len(weights)
        places = lines.first_of(np.arange(-2, lines.cells + 3))
        self.nodes = (self.points[..., None] + self.direction[:, None, None] * places).reshape(len(self.points), -1)
        every = _blocks(self.nodes.shape[1])
        values = np.concatenate([lines.values(signed, self.nodes[:, some]) for some in every])
        values = values.reshape(-1, len(places))
        self.cubics = cubics_through(values)
        _, slope, bend, rest = self.cubics
        line, cell = np.nonzero(slope * (slope + 2 * bend + 3 * rest) < 0)
        turned = self.cubics[:, line, cell]
        middle, heights = extremum_within(*turned[1:]), values[:, 2:-2]
        count, at = len(heights), line * lines.cells + cell
        every, height = np.arange(count * lines.cells), horner(turned, middle[None])[0]
        self.line, self.cell = np.append(every // lines.cells, line), np.append(every % lines.cells, cell)
        self.left, self.right = np.append(np.zeros(len(every)), middle), np.ones(len(every) + len(line))
        self.value_left = np.append(heights[:, :-1], height)
        self.value_right = np.append(heights[:, 1:], heights[line, cell + 1])
        self.right[at], self.value_right[at] = middle, height
        ends = beyond(lines.first_of(np.arange(lines.cells + 1)))
        inner = beyond(lines.first_of(cell) + middle * lines.step)
        self.masses = np.append(np.tile(ends[:-1] - ends[1:], count), inner - ends[cell + 1])
        self.masses[at] = ends[cell] - inner

    @override
    @quietly
    def cut(self, threshold: float) -> Cut:
        low, high = self.value_left < threshold, self.value_right < threshold
        parts = np.flatnonzero(low != high)
        line, cell, is_falling = self.line[parts], self.cell[parts], high[parts]
        left, right = self.left[parts], self.right[parts]
        cubic = self.cubics[:, line, cell]
        cubic[0] -= threshold
        place = root_within(cubic, left, right, ~is_falling)
        start, end = np.where(is_falling, place, left), np.where(is_falling, right, place)
        step, first = self.lines.step, self.lines.first_of(cell)
        along, inside = first + place * step, low & high
        crossed = beyond(first + start * step) - beyond(first + end * step)
        slope = np.abs(with_slope(cubic, place[None])[1][0]) / step
        densities = np.where(slope > 0, density_of(along) / slope, 0.0)
        count = len(self.share)
        fractions = np.bincount(self.line, self.masses * inside, count) + np.bincount(line, crossed, count)
        below, density = self.share @ fractions, self.share[line] @ densities
        doubt = float(self.share[line] @ (self._is_steep(line, along) * density_of(along))) * (step + _CELL)
        where = inside, fractions, line, cell, along, densities, start, end - start
        return Cut(below, density, doubt, (), *where)

    def _is_steep(self, line: Int[np.ndarray, " n"], along: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Whether a germ variable is steep nearby."""
        if not self.lines.is_steep.any():
            return np.zeros(len(line), bool)
        places = self.points[:, line] + np.outer(self.direction, along) + LAST
        reach = self.lines.step * np.abs(self.direction)[:, None] + _CELL
        counts = np.pad(np.cumsum(self.lines.is_steep, axis=1), ((0, 0), (1, 0)))
        first, last = (np.clip((places + side * reach) / _CELL, 0, TABLED).astype(int) for side in (-1, 1))
        return np.any(np.take_along_axis(counts, last, axis=1) > np.take_along_axis(counts, first, axis=1), axis=0)

    @override
    def below(self, threshold: float, at: Cut) -> tuple[float, Float[np.ndarray, " terms"]]:
        crossings, rates = (
            self.points[:, at.line] + np.outer(self.direction, at.along),
            self.share[at.line] * at.densities,
        )
        value, slopes = at.below, np.zeros(len(self.signed))
        for some in _blocks(len(rates)):
            terms, rate = self.lines.terms(crossings[:, some]), rates[some]
            off = self.signed @ terms - threshold
            # What the output itself is off at the crossings of its cubics, unless it hardly rises there.
            is_near = np.abs(off * at.densities[some]) < density_of(at.along[some]) * self.lines.step
            value, slopes = value - rate @ np.where(is_near, off, 0.0), slopes - terms @ rate
        return float(value), slopes

    @override
    def shortfall(self, threshold: float, at: Cut) -> tuple[float, Float[np.ndarray, " terms"]]:
        parts = np.flatnonzero(at.inside)
        line, cell = np.append(self.line[parts], at.line), np.append(self.cell[parts], at.cell)
        start, length = np.append(self.left[parts], at.start), self.right[parts] - self.left[parts]
        every = integrals_of_powers(start, np.append(length, at.length), self.lines.first_of(cell), self.lines.step)
        shape = self.cubics.shape
        places, size = line * self.lines.cells + cell, shape[1] * shape[2]
        powers = np.stack([np.bincount(places, each, size) for each in every]).reshape(shape)
        powers = self.share[:, None] * powers
        by_node = -by_values(powers).ravel()
        each = [self.lines.terms(self.nodes[:, some]) @ by_node[some] for some in _blocks(len(by_node))]
        return float(threshold * np.sum(powers[0]) - np.sum(powers * self.cubics)), np.sum(each, axis=0)

    @override
    def change(
        self, threshold: float, at: Cut, slopes: Float[np.ndarray, " terms"]
    ) -> tuple[float, Float[np.ndarray, " terms"]]:
        """Where lines touch the threshold, as around a region that surrounds the mean, both are infinite on these.
        There they come from what lies within a shell about it, being those of the shortfall's derivative.
        """
        if not (self.lines.is_whole_lattice and at.density > 0 and self.error(at) > _TOUCHING * at.below):
            return at.density, slopes
        reach = _SHELL * at.below / at.density
        ends = threshold - reach, threshold + reach
        cuts = [self.cut(end) for end in ends]
        inner, outer = (self.shortfall(end, cut)[1] for end, cut in zip(ends, cuts, strict=True))
        return (cuts[1].below - cuts[0].below) / (2 * reach), (outer - inner) / (2 * reach)

    @override
    def error(self, at: Cut) -> float:
        """By the scatter of the replicates: all of them together are more accurate, as parts of one net.

        Zero but for the doubt where one line is exact.
        """
        replicates, count = self.lines.normals.shape[1:]
        if replicates == 1:
            return at.doubt
        weights, fractions = self.share.reshape(replicates, count), at.fractions.reshape(replicates, count)
        each = np.sum(weights * fractions, axis=1) / np.sum(weights, axis=1)
        covers = float(scipy.special.stdtrit(replicates - 1, 0.975)) / math.sqrt(replicates)
        return covers * float(np.std(each, ddof=1)) + at.doubt


@final
class TailInElements(AbstractLowerTail):
    """The probability below a threshold as the sum over elements."""

    close: ClassVar[float] = TailByLines.close

    def __init__(self, signed: Float[np.ndarray, " terms"], lines: LinesInElements):
        division = lines.division
        self.std, self.division, self.share = (
            float(np.sqrt(np.sum(signed**2))),
            division,
            np.asarray(division.roots) ** 2,
        )
        self.signed = np.asarray(division.elements(signed))
        each = [jax.tree.map(lambda leaf, i=i: leaf[i], lines.lines) for i in range(len(self.share))]
        self.tails = [TailByLines(own, part) for own, part in zip(self.signed, each, strict=True)]

    @override
    def cut(self, threshold: float) -> Cut:
        every = tuple(tail.cut(threshold) for tail in self.tails)
        below, density = (self.share @ np.array([cut[k] for cut in every]) for k in (0, 1))
        return Cut(below, density, elements=every)

    def _summed(self, each: list[tuple[float, np.ndarray]]) -> tuple[float, Float[np.ndarray, " terms"]]:
        values, slopes = zip(*each, strict=True)
        return float(self.share @ np.array(values)), self._by_whole(self.share[:, None] * np.stack(slopes))

    def _by_whole(self, slopes: Float[np.ndarray, "elements terms"]) -> Float[np.ndarray, " all_terms"]:
        """Derivatives by the coefficients of the whole expansion, from those by the coefficients of elements."""
        return np.asarray(self.division.whole(slopes / self.share[:, None]))

    @override
    def below(self, threshold: float, at: Cut) -> tuple[float, Float[np.ndarray, " terms"]]:
        pairs = zip(self.tails, at.elements, strict=True)
        return self._summed([tail.below(threshold, own) for tail, own in pairs])

    @override
    def shortfall(self, threshold: float, at: Cut) -> tuple[float, Float[np.ndarray, " terms"]]:
        pairs = zip(self.tails, at.elements, strict=True)
        return self._summed([tail.shortfall(threshold, own) for tail, own in pairs])

    @override
    def error(self, at: Cut) -> float:
        each = [tail.error(own) for tail, own in zip(self.tails, at.elements, strict=True)]
        return float(np.sqrt(np.sum((self.share * np.array(each)) ** 2)))

    @override
    def quantile(self, level: float) -> Place:
        """One that many systems share, as those of a stop do, moves with their elements, which are constant."""
        quantile, cut, slopes, by_level = super().quantile(level)
        rest = np.sqrt(np.sum(self.signed[:, 1:] ** 2, axis=1))
        away = np.maximum(np.abs(self.signed[:, 0] - quantile), rest)
        shares = np.where(away <= _CONSTANT * self.std, self.share, 0.0)
        moved = np.zeros(self.signed.shape)
        moved[:, 0] = shares / max(float(np.sum(shares)), np.finfo(float).tiny)
        return Place(quantile, cut, slopes + self._by_whole(moved), by_level)

    @override
    def slope(self, off: float, cut: Cut) -> float:
        return cut.density if abs(off) <= self.close else 0.0


def _blocks(count: int) -> list[slice]:
    """Which of so many points are evaluated at once."""
    return [slice(first, first + _TOGETHER) for first in range(0, count, _TOGETHER)]
