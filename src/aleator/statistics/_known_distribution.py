"""The distribution of an output whose coefficients are known, by its tails, in NumPy: nothing is compiled."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator.statistics._known_lines import is_whole_lattice
from aleator.statistics._known_tails import AbstractKnownTail, KnownTailByLines, KnownTailInElements, Place
from aleator.statistics._lines import AnyLines, LinesInElements
from aleator.statistics._lower_tails import EQUAL

# Lines run along a variable too where the others state a larger error of a probability, and count if they differ from
# these by no more than so many such errors.
_DOUBTFUL, _COVERED = 1e-8, 2


class Known(NamedTuple):
    """A statistic of an output, the 95 % half-width of its integral, and its derivatives by the coefficients."""

    value: float
    error: float
    slopes: Float[np.ndarray, " terms"]


@final
class KnownDistribution:
    """The distribution of an output by its coefficients, as `OutputDistribution`. `lines`: of NumPy's arrays."""

    def __init__(self, coefficients: Float[np.ndarray, " terms"], lines: AnyLines):
        self.coefficients, self.lines = coefficients, lines
        self.rest = np.where(np.arange(len(coefficients)) > 0, coefficients, 0.0)

    def _side(
        self, search: Callable[[AbstractKnownTail], Place], *, is_lower: bool
    ) -> tuple[float, AbstractKnownTail, Place]:
        """The sign of a tail, the tail, and the threshold that is sought in it, along lines with the smaller error.

        Where the output bends, lines to its smallest values meet a threshold twice, or touch it, even if it rises all
        along one of the variables: lines along this variable meet it once, if they find as much within what the others
        may be off by.
        """
        sign, lines = 1.0 if is_lower else -1.0, self.lines
        if isinstance(lines, LinesInElements):
            elements = KnownTailInElements(sign * self.rest, lines)
            return sign, elements, search(elements)
        tail = KnownTailByLines(sign * self.rest, lines)
        place = search(tail)
        error = tail.error(place.cut)
        if not (is_whole_lattice(lines) and error > _DOUBTFUL):
            return sign, tail, place
        axial = KnownTailByLines(sign * self.rest, lines, is_axial=True)
        again = search(axial)
        moved = abs(again.threshold - place.threshold) * place.cut.density
        agrees = abs(again.cut.below - place.cut.below) + moved <= _COVERED * error
        return (sign, axial, again) if agrees and axial.error(again.cut) < error else (sign, tail, place)

    def _slopes(self, by_mean: float, by_others: Float[np.ndarray, " terms"]) -> Float[np.ndarray, " terms"]:
        return np.where(np.arange(len(by_others)) > 0, by_others, by_mean)

    def chance(self, value: Any, *, above: bool, or_equal: bool = False) -> Known:
        """The probability of more than a value, or of less."""
        rounding = EQUAL * float(np.sqrt(np.sum(self.coefficients**2)))
        off = float(value) - float(self.coefficients[0]) + (rounding if above != or_equal else -rounding)
        threshold = -abs(off)
        sign, tail, (_, at, _) = self._side(lambda tail: Place(threshold, tail.cut(threshold)), is_lower=off < 0)
        beyond, slopes = tail.below(threshold, at)
        density, slopes = tail.change(threshold, at, slopes)
        # By the mean, from the density; by what follows, through the sign of the tail's own coefficients.
        slopes = self._slopes(-sign * density, sign * slopes)
        is_beyond = (off < 0) != above
        return Known(beyond if is_beyond else 1 - beyond, tail.error(at), slopes if is_beyond else -slopes)

    def between(self, low: Any, high: Any) -> Known:
        """The probability of values between two, these included."""
        under, over = self.chance(low, above=False, or_equal=True), self.chance(high, above=True, or_equal=True)
        return Known(1 - under.value - over.value, under.error + over.error, -under.slopes - over.slopes)

    def quantile(self, level: Any) -> Known:
        """The value that the output stays below with a probability."""
        is_lower = float(level) < 0.5
        own = float(level) if is_lower else 1 - float(level)
        sign, tail, (quantile, at, slopes) = self._side(lambda tail: tail.quantile(own), is_lower=is_lower)
        share = tail.error(at)
        error = abs(quantile) if share > own / 2 else share / at.density if at.density > 0 else 0.0
        return Known(float(self.coefficients[0]) + sign * quantile, error, self._slopes(1.0, slopes))

    def mean_beyond(self, level: Any, *, lower: bool) -> Known:
        """The mean of the values below a quantile, or above it."""
        level = float(level)
        is_lower = level < 0.5
        own = level if is_lower else 1 - level
        sign, tail, (quantile, at, moving) = self._side(lambda tail: tail.quantile(own), is_lower=is_lower)
        shortfall, slopes = tail.shortfall(quantile, at)
        # The quantile contributes where many systems share it: else as much lies below as the level says.
        below, slopes = quantile - shortfall / own, moving * (1 - at.below / own) - slopes / own
        # The mean of all is zero, so that those on the other side of the quantile balance these.
        factor = 1.0 if is_lower == lower else -own / (1 - own)
        slope = abs(factor * below - quantile) / (level if lower else 1 - level)
        value = float(self.coefficients[0]) + sign * factor * below
        return Known(value, tail.error(at) * slope, self._slopes(1.0, factor * slopes))
