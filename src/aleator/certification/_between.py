"""Limits over time between the instants, by CHECK: how far they are exceeded there, and the margins that enforce them.

Bounds are tightened by what is exceeded. In the end rows limit peaks, and the values beside jumps, instead of their
own: so the answer does not depend on where the instants are, and its multipliers are slopes of the optimum.

At the knots of trajectories and controls outputs may jump, such as torques of a motion of degree 2. An instant has the
value after a jump only, so that the sides before and after it are judged separately.

A row limits its own value, with a margin for what lies beside it; the peak of the parabola through it and its
neighbours, where the path is smooth; or, beside a jump, the value there, which the rows since the last knot tell if
there are two. Places on a path are in steps of the finer grid.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from aleator._core.arrays import jax_array
from aleator.certification._check import Check, Limit
from aleator.certification._systems import parts_in
from aleator.design import is_over_time, path_of, statistics_in
from aleator.dynamics import Simulation
from aleator.nlp import HELD, End, NonlinearProgram, Outcome, Peak, with_peaks
from aleator.solution import Between
from aleator.statistics import Mean
from aleator.trajectories import BSpline, jumping_in, piecewise_in
from aleator.transcription import AbstractTranscribed, bound_size, excess_of
from aleator.uncertainty import at_means, realise

# A jump exceeds this many changes between neighbouring fine instants, and this part of the values.
_STEEP, _LEAST = 5.0, 1e-6
# A parabola through neighbouring rows tells a peak if it misses that by no more than this part of their range.
_MISSED = 0.05
# A knot within this many steps of an instant coincides with it up to rounding.
_AT = 1e-6

Which: TypeAlias = tuple[int, int]
"""A row of a path and an entry of it."""


class Shift(NamedTuple):
    """What the rows of a limit require at a point.

    - `by`: how far each bound must move further inwards so that the worst value nearby meets it, negative where it may
      move outwards;
    - `instead`: what some rows limit in the place of their own values, by numbers of rows, and by how much the finer
      grid exceeds that;
    - `is_coarse`: whether a jump exceeds the limit beside a single row.
    """

    by: Float[np.ndarray, "limited entries"]
    instead: dict[Which, tuple[Peak | End, float]]
    is_coarse: bool = False


class Jump(NamedTuple):
    """A jump of a path: its place, and the values before and after it."""

    place: float
    before: Float[np.ndarray, " entries"]
    after: Float[np.ndarray, " entries"]


def jumps(values: Float[np.ndarray, "finer entries"], knots: Float[np.ndarray, " knots"]) -> list[Jump]:
    """The jumps of a path at knots, with values from straight lines."""
    last, size, every = len(values) - 1, float(np.abs(values).max(initial=0.0)), []
    for place in knots.tolist():
        left, right = int(np.ceil(place - _AT)) - 1, int(np.floor(place + _AT)) + 1
        if left < 1 or right > last - 1:
            continue
        rising, going = values[left] - values[left - 1], values[right + 1] - values[right]
        before, after = values[left] + rising * (place - left), values[right] - going * (right - place)
        change = max(float(np.abs(rising).max()), float(np.abs(going).max()))
        if float(np.abs(after - before).max()) > _STEEP * change + _LEAST * size:
            every.append(Jump(place, before, after))
    return every


class LimitedPath(NamedTuple):
    """One path with its limit.

    - `rows`: the values that are limited, at `places`; `knots`: where the path may jump;
    - `jumps`: see the function; `least`: what counts as an excess. A path that runs along its bound has peaks of
      rounding, which move with it.
    """

    limit: Limit
    rows: Float[np.ndarray, "limited entries"]
    places: Float[np.ndarray, " limited"]
    knots: Float[np.ndarray, " knots"]
    jumps: list[Jump]
    least: float

    def shift(self, known: dict[Which, Peak | End], *, at_peaks: bool) -> Shift:
        """What its rows require, each entry by itself.

        - `known`: what rows limit instead at present; `at_peaks`: whether they may limit peaks.
        """
        fine, by, instead, is_coarse = np.arange(len(self.limit.fine)), np.zeros(self.rows.shape), {}, False
        smooth = self._smooth() if at_peaks else np.zeros(0, int)
        beside = [self._beside(one.place) for one in self.jumps]
        for entry, beyond in enumerate(self._excess(self.limit.fine).T):
            peaking = [i for (i, of), one in known.items() if of == entry and isinstance(one, Peak)]
            sides, ends = self._sides(entry, beside)
            every = [*self._peaks(entry, beyond, (np.array(peaking, int), smooth)), *filter(None, ends)]
            is_coarse |= None in ends
            own = beyond.copy()
            for one in every:
                own[(one.low < fine) & (fine < one.high)] = -np.inf
            by[:, entry] = _shifts(own, self.places, sides)
            for one in every:
                by[one.row, entry] = one.excess
                instead[one.row, entry] = one.limits, one.excess - self._excess_by(entry, one.limits)
        return Shift(by, instead, is_coarse)

    def _excess(self, values: ArrayLike) -> Float[np.ndarray, "..."]:
        """How far values are beyond the nearer bound."""
        return excess_of(self.limit.constraint, np.asarray(values))

    def _excess_by(self, entry: int, one: Peak | End) -> float:
        """How far what a row limits instead is beyond the nearer bound."""
        return float(self._excess(one.at(self.rows[:, entry]).value))

    def _smooth(self) -> Int[np.ndarray, " smooth"]:
        """The rows between whose neighbours there is no knot, and none at which the path jumps at a neighbour either,
        whose value may be that before it.
        """
        below, above = np.searchsorted(self.knots, self.places + _AT), np.searchsorted(self.knots, self.places - _AT)
        at = np.array([one.place for one in self.jumps])
        before, after = np.searchsorted(at, self.places - _AT), np.searchsorted(at, self.places + _AT)
        return np.flatnonzero((below[:-2] == above[2:]) & (before[:-2] == after[2:])) + 1

    def _peaks(
        self, entry: int, beyond: Float[np.ndarray, " finer"], preferred: tuple[Int[np.ndarray, " some"], ...]
    ) -> "list[_Instead]":
        """The peaks of the finer grid that could break the limit, if parabolas through neighbouring rows tell them:
        the row closest to each.

        - `preferred`: rows that may limit peaks, those that do already first: until a peak leaves their parabolas.
        """
        every, rows, places = dict[int, _Instead](), self.rows[:, entry], self.places
        before, middle, after = beyond[:-2], beyond[1:-1], beyond[2:]
        for j in np.flatnonzero((middle > before) & (middle >= after)) + 1:
            step, bend = beyond[j + 1] - beyond[j - 1], beyond[j - 1] - 2 * beyond[j] + beyond[j + 1]
            place, height = j - step / (2 * bend), float(beyond[j] - step**2 / (8 * bend))
            near = [some[(places[some - 1] < place) & (place < places[some + 1])] for some in preferred]
            near = next((some for some in near if some.size), None)
            if near is None:
                continue
            i = int(near[np.argmin(np.abs(places[near] - place))])
            excess = float(self._excess(rows[i]))
            if height + abs(height - excess) <= self.least:
                continue
            around = np.arange(i - 1, i + 2)
            peak = Peak(around, places[around], 1 if excess == rows[i] - float(self.limit.constraint.upper) else -1)
            is_told = abs(height - self._excess_by(entry, peak)) <= _MISSED * float(np.ptp(rows[around]))
            if is_told and height > (every[i].excess if i in every else -np.inf):
                every[i] = _Instead(i, peak, height, places[i - 1], places[i + 1])
        return [*every.values()]

    def _sides(
        self, entry: int, beside: list[tuple[Int[np.ndarray, " before"], Int[np.ndarray, " after"]]]
    ) -> "tuple[list[tuple[float, float, float]], list[_Instead | None]]":
        """The places of jumps, each with the excess before and after it that margins have to prevent; and the sides
        that could break the limit and that a row limits, None for those beside which there is one row alone.

        - `beside`: the rows next to each jump.
        """
        sides, ends = [], []
        for (place, *values), rows in zip(self.jumps, beside, strict=True):
            excesses = []
            for value, nearest in zip(values, rows, strict=True):
                excess, instead = float(self._excess(value[entry])), None
                own = float(self._excess(self.rows[nearest[0], entry])) if nearest.size else -np.inf
                # A path that falls towards a jump is limited by its rows.
                if nearest.size > 1 and excess > own and excess + (excess - own) > self.least:
                    reach = sorted((place, float(self.places[nearest[0]])))
                    instead = _Instead(int(nearest[0]), End.of(nearest, self.places, place), excess, *reach)
                if instead is not None or excess > max(own, self.least):
                    ends.append(instead)
                excesses.append(excess if instead is None else -np.inf)
            sides.append((place, *excesses))
        return sides, ends

    def _beside(self, place: float) -> tuple[Int[np.ndarray, " before"], Int[np.ndarray, " after"]]:
        """The three rows next to a jump at most, on either side of it up to the next knot, the nearest first. A row at
        a knot has the value after it, so that it needs no other. The first row of all is none of them if a spread
        stands in the limit: where all begin alike it vanishes, and has a kink.
        """
        first = int(any(not isinstance(one.kind, Mean) for one in statistics_in((self.limit.constraint.expression,))))
        since = self.knots[self.knots < place - _AT].max(initial=-np.inf)
        until = self.knots[self.knots > place + _AT].min(initial=np.inf)
        before = np.flatnonzero((self.places > since - _AT) & (self.places < place - _AT))
        after = np.flatnonzero((self.places > place - _AT) & (self.places < until - _AT))
        return before[before >= first][::-1][:3], after[after >= first][:3]


class _Instead(NamedTuple):
    """What a row limits in the place of its own value, the excess there, and the places between which it answers."""

    row: int
    limits: Peak | End
    excess: float
    low: float
    high: float


def _shifts(
    beyond: Float[np.ndarray, " finer"],
    places: Float[np.ndarray, " limited"],
    sides: list[tuple[float, float, float]],
) -> Float[np.ndarray, " limited"]:
    """The shifts at both ends of each interval that its worst value requires, in proportion to their proximity.

    - `places`: the ends of the intervals, in steps of the finer grid.

    Shifts `e (1 - s)` and `e s`, divided by `(1 - s)² + s²`, change a straight line between them by `e` at the fraction
    `s`. In an interval with jumps, each end answers for its own side of them only.
    """
    low, high = np.ceil(places[:-1] - _AT).astype(int), np.floor(places[1:] + _AT).astype(int)
    which = np.minimum(low[:, None] + np.arange((high - low).max() + 1), high[:, None])
    inside = np.where((low <= high)[:, None], beyond[which], -np.inf)
    worst = (np.arange(len(low)), np.argmax(inside, axis=1))
    excess, s = inside[worst], np.clip((which[worst] - places[:-1]) / np.diff(places), 0.0, 1.0)
    share = np.stack([1 - s, s]) / ((1 - s) ** 2 + s**2)
    first, last = np.where(excess > 0, share * np.maximum(excess, 0.0), excess)
    fine = np.arange(len(beyond))
    for i, (begin, end) in enumerate(itertools.pairwise(places)) if sides else ():
        here = [side for side in sides if begin - _AT <= side[0] <= end + _AT]
        if here:
            # Exactly at a jump, rounding decides which side an instant's value belongs to. That of a row is after it.
            begun, later = (
                [side for side in here if (side[0] > begin + _AT) == is_later] for is_later in (False, True)
            )
            if later:
                earliest, before, _ = later[0]
                left = (begin + (_AT if begun else -_AT) < fine) & (fine < earliest - _AT)
                first[i] = max([before, *(after for *_, after in begun), *beyond[left]])
            else:
                first[i] = -np.inf
            latest, _, after = here[-1]
            right = (latest + _AT < fine) & (fine <= end)
            last[i] = max([after, *beyond[right]]) if latest < end - _AT else -np.inf
    return np.maximum(np.append(first, -np.inf), np.append(-np.inf, last))


class Margin(NamedTuple):
    """How the rows of a limit over time are imposed.

    - `by`: how far the bounds of each row are moved inwards;
    - `instead`: what some rows limit in the place of their own values, by numbers of rows.
    """

    by: Float[np.ndarray, "limited entries"]
    instead: dict[Which, Peak | End]


Margins = tuple[Margin | None, ...]
Shifts = tuple[Shift | None, ...]
"""Those of each constraint; None for limits on no path or peak, and for equalities, of which no margin can enforce both
sides.
"""


def excess_between(check: Check, margins: Margins | None = None, *, at_peaks: bool = False) -> tuple[Between, Shifts]:
    """How far a problem's limits over time are exceeded on a finer grid at most, and what their rows require.

    - `margins`: those with which the point was found, None for none;
    - `at_peaks`: whether peaks between the instants are imposed where paths are smooth.
    """
    transcribed, between, shifts = check.transcribed, Between(check.factor, 0.0, "", 0.0), list[Shift | None]()
    decisions = jax_array(transcribed.decisions(check.point))
    model = realise(at_means(check.problem.simulation), jax_array(np.zeros(0)), decisions)
    each = check.limits, transcribed.scales, check.meaning.constraints, margins or [None] * len(transcribed.rows)
    for limit, scale, rows, margin in zip(*each, strict=True):
        one, shift, path = limit.constraint, None, path_of(limit.constraint)
        if is_over_time(one):
            beyond, last, size = limit.beyond, len(limit.fine) - 1, bound_size(one) or scale
            knots = _knots(model.of(path)) * last if path else np.zeros(0)
            sides = jumps(limit.fine, knots)
            if float(one.lower) != float(one.upper):
                shift = Shift(beyond, {})
                if path:
                    places = transcribed.limited(path) * last
                    limited = LimitedPath(limit, rows.reshape(len(places), -1), places, knots, sides, HELD * size)
                    shift = limited.shift({} if margin is None else margin.instead, at_peaks=at_peaks)
            # NaN counts as the largest excess.
            worst = beyond.max(axis=1)
            candidates = [(float(worst.max()), int(np.argmax(worst)))]
            candidates += [(float(excess_of(one, np.stack(side[1:])).max()), int(side.place)) for side in sides]
            largest, place = max((np.inf if np.isnan(most) else most, place) for most, place in candidates)
            if largest / size > between.worst:
                between = Between(check.factor, largest / size, one.name, float(limit.times[place // limit.factor]))
        shifts.append(shift)
    is_coarse = any(one is not None and one.is_coarse for one in shifts)
    return replace(between, is_coarse=is_coarse), tuple(shifts)


def _knots(model: Simulation) -> Float[np.ndarray, " knots"]:
    """The inner knots of splines, nodes of controls and declared jumps of a realisation, as fractions of its time."""
    parts, grid = (model.system, model.inputs), model.grid
    ends = (one.breaks() for one in (*parts_in(parts, BSpline), *piecewise_in(parts)))
    start, final = (float(end) for end in (grid.t_start, grid.t_final))
    times = (np.asarray(one.jumps) for one in jumping_in(parts))
    fractions = np.concatenate([np.zeros(0), *ends, *((each - start) / (final - start) for each in times)])
    return np.unique(fractions[(fractions > 0) & (fractions < 1)])


def margins_for(margins: Margins | None, shifts: Shifts, *, relax: bool) -> Margins:
    """Margins updated by shifts, None for none yet. With `relax` they shrink where limits hold with slack, and other
    peaks are imposed.
    """
    every = list[Margin | None]()
    for old, new in zip(margins or [None] * len(shifts), shifts, strict=True):
        if new is None:
            every.append(None)
        elif relax or old is None:
            moved = np.maximum(new.by + (0.0 if old is None else old.by), 0.0)
            for which, (_, left) in new.instead.items():
                moved[which] = left
            every.append(Margin(moved, {which: one for which, (one, _) in new.instead.items()}))
        else:
            every.append(old._replace(by=old.by + 1.2 * np.maximum(new.by, 0.0)))
    return tuple(every)


def limits_beside(margins: Margins) -> bool:
    """Whether any row limits a peak, or a value beside a jump."""
    return any(one is not None and one.instead for one in margins)


def tightened(transcribed: AbstractTranscribed, margins: Margins) -> NonlinearProgram:
    """The program with its limits over time imposed as margins say."""
    program, peaks = transcribed.program, list[Peak | End]()
    lower, upper = program.constraint_lower.copy(), program.constraint_upper.copy()
    for rows, margin in zip(transcribed.rows, margins, strict=True):
        if margin is None:
            continue
        moved = margin.by.ravel()
        lower[rows], upper[rows] = lower[rows] + moved, upper[rows] - moved
        width = margin.by.shape[-1]
        peaks += [what._replace(rows=rows.start + what.rows * width + of) for (_, of), what in margin.instead.items()]
    program = replace(program, constraint_lower=lower, constraint_upper=upper)
    return with_peaks(program, peaks) if peaks else program


def cost_of_margins(transcribed: AbstractTranscribed, margins: Margins, loosest: float, outcome: Outcome) -> float:
    """How much worse an objective is by bounds that were moved inwards at rows that limit their own values, which costs
    more than it has to, relative to the larger one.
    """
    tightest, each = outcome.evaluation.objective, zip(margins, transcribed.scales, strict=True)
    moved = ((one, np.argwhere(one.by > HELD * size).tolist()) for one, size in each if one is not None)
    narrows = any(tuple(which) not in one.instead for one, every in moved for which in every)
    return (tightest - loosest) / max(abs(loosest), abs(tightest)) if narrows and tightest > loosest else 0.0
