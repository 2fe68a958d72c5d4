"""Limits over time between the instants, by CHECK: how far they are exceeded there, and the margins that enforce them.

Bounds are tightened by what is exceeded. Where a path is smooth, a row limits the peak of the parabola through its
neighbours in the end: so the answer does not depend on where the instants are, and its multipliers are slopes of the
optimum.

At the knots of trajectories outputs may jump, such as torques of a motion of degree 2. An instant has the value of one
side of a jump only, so that the sides before and after it are judged separately.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from aleator._core.arrays import jax_array
from aleator.certification._check import Check
from aleator.certification._fresh import parts_in
from aleator.certification._limits import Limit, limits_at
from aleator.design import is_over_time, path_of
from aleator.dynamics import Simulation
from aleator.nlp import HELD, NonlinearProgram, Peak, extreme, with_peaks
from aleator.solution import Between
from aleator.trajectories import BSpline, jumping_in, piecewise_in
from aleator.transcription import AbstractTranscribed, bound_size, excess_of
from aleator.uncertainty import at_means, realise

# A jump exceeds this many changes between neighbouring fine instants, and this part of the values.
_STEEP, _LEAST = 5.0, 1e-6
# A parabola through neighbouring rows tells a peak if it misses that by no more than this part of their range.
_MISSED = 0.05
# Fractions of the duration that differ by less are the same.
_SAME = 1e-9
# A knot within this many steps of an instant coincides with it up to rounding.
_AT = 1e-6


class Margin(NamedTuple):
    """How the rows of a limit over time are imposed.

    - `by`: how far the bounds of each row are moved inwards;
    - `peaks`: 1 for rows of which the highest value within a step is imposed, -1 for the lowest, else 0.
    """

    by: Float[np.ndarray, "limited entries"]
    peaks: Int[np.ndarray, "limited entries"]


class Shift(NamedTuple):
    """What the rows of a limit require at a point.

    - `by`: how far each bound must move further inwards so that the worst value nearby meets it, negative where it may
      move outwards;
    - `peaks`: see `Margin`; `left`: by how much the finer grid exceeds those, NaN for other rows.
    """

    by: Float[np.ndarray, "limited entries"]
    peaks: Int[np.ndarray, "limited entries"]
    left: Float[np.ndarray, "limited entries"]


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
    transcribed, between, shifts = check.transcribed, Between(check.factor, 0.0, "", 0.0), []
    decisions = jax_array(transcribed.decisions(check.point))
    model = realise(at_means(check.problem.simulation), jax_array(np.zeros(0)), decisions)
    each = limits_at(check), transcribed.scales, check.meaning.constraints, margins or [None] * len(transcribed.rows)
    for limit, scale, rows, margin in zip(*each, strict=True):
        one, shift, path = limit.constraint, None, path_of(limit.constraint)
        if is_over_time(one):
            beyond, knots = excess_of(one, limit.fine), _knots(model.of(path)) if path else np.zeros(0)
            # Places in steps of the finer grid, with the excess before and after.
            every = jumps(limit.fine, knots)
            sides = [(place, excess_of(one, before), excess_of(one, after)) for place, before, after in every]
            if float(one.lower) != float(one.upper):
                if path:
                    limited, last = transcribed.limited(path), len(beyond) - 1
                    smooth = _smooth(limited, knots, sides, last) if at_peaks else np.zeros(0, int)
                    rows, least = rows.reshape(len(limited), -1), HELD * (bound_size(one) or scale)
                    shift = _shift(limit, rows, limited * last, sides, (smooth, least), margin)
                else:
                    shift = Shift(beyond, np.zeros(beyond.shape, int), np.full(beyond.shape, np.nan))
            # NaN counts as the largest excess.
            worst = beyond.max(axis=1)
            candidates = [(float(worst.max()), int(np.argmax(worst)))]
            candidates += [(float(np.max(side[1:])), int(side[0])) for side in sides]
            largest, place = max((np.inf if np.isnan(most) else most, place) for most, place in candidates)
            largest /= bound_size(one) or scale
            if largest > between.worst:
                between = Between(check.factor, largest, one.name, float(limit.times[place // limit.factor]))
        shifts.append(shift)
    return between, tuple(shifts)


def _knots(model: Simulation) -> Float[np.ndarray, " knots"]:
    """The inner knots of splines, nodes of controls and declared jumps of a realisation, as fractions of its time."""
    parts, grid = (model.system, model.inputs), model.grid
    ends = (one.breaks() for one in (*parts_in(parts, BSpline), *piecewise_in(parts)))
    start, final = (float(end) for end in (grid.t_start, grid.t_final))
    times = (np.asarray(one.jumps) for one in jumping_in(parts))
    fractions = np.concatenate([np.zeros(0), *ends, *((each - start) / (final - start) for each in times)])
    return np.unique(fractions[(fractions > 0) & (fractions < 1)])


def _smooth(
    limited: Float[np.ndarray, " limited"],
    knots: Float[np.ndarray, " knots"],
    sides: Sequence[tuple[float, np.ndarray, np.ndarray]],
    last: int,
) -> Int[np.ndarray, " smooth"]:
    """The rows between whose neighbours there is no knot, and none at which the path jumps at a neighbour either, whose
    value may be that before it.
    """
    below, above = np.searchsorted(knots, limited + _SAME), np.searchsorted(knots, limited - _SAME)
    at = np.array([place for place, *_ in sides]) / last
    before, after = np.searchsorted(at, limited - _SAME), np.searchsorted(at, limited + _SAME)
    return np.flatnonzero((below[:-2] == above[2:]) & (before[:-2] == after[2:])) + 1


def jumps(
    values: Float[np.ndarray, "finer entries"], at: Float[np.ndarray, " knots"]
) -> list[tuple[float, Float[np.ndarray, " entries"], Float[np.ndarray, " entries"]]]:
    """The jumps of a path at knots: place in steps of the finer grid, values before and after, from straight lines."""
    last, size, every = len(values) - 1, float(np.abs(values).max(initial=0.0)), []
    for place in (at * last).tolist():
        left, right = int(np.ceil(place - _AT)) - 1, int(np.floor(place + _AT)) + 1
        if left < 1 or right > last - 1:
            continue
        rising, going = values[left] - values[left - 1], values[right + 1] - values[right]
        before, after = values[left] + rising * (place - left), values[right] - going * (right - place)
        change = max(float(np.abs(rising).max()), float(np.abs(going).max()))
        if float(np.abs(after - before).max()) > _STEEP * change + _LEAST * size:
            every.append((place, before, after))
    return every


def _shift(
    limit: Limit,
    rows: Float[np.ndarray, "limited entries"],
    places: Float[np.ndarray, " limited"],
    sides: list[tuple[float, np.ndarray, np.ndarray]],
    smooth: tuple[Int[np.ndarray, " smooth"], float],
    margin: Margin | None,
) -> Shift:
    """What the rows of a limit on a path require, each entry by itself.

    - `places`: of the rows, in steps of the finer grid; `smooth`: those that may limit peaks, and from which excess on;
    - `margin`: the present one.
    """
    beyond, fine = excess_of(limit.constraint, limit.fine), np.arange(len(limit.fine))
    shift = Shift(np.zeros(rows.shape), np.zeros(rows.shape, int), rows * np.nan)
    for entry, own in enumerate(beyond.T):
        here = [(place, float(before[entry]), float(after[entry])) for place, before, after in sides]
        known = np.zeros(0, int) if margin is None else np.flatnonzero(margin.peaks[:, entry])
        peaks = _peaks(limit, own, rows[:, entry], places, (known, smooth[0]), smooth[1])
        without = own.copy()
        for i, *_ in peaks:
            without[(places[i - 1] < fine) & (fine < places[i + 1])] = -np.inf
        shift.by[:, entry] = _shifts(without, places, here)
        for i, side, height, left in peaks:
            shift.by[i, entry], shift.peaks[i, entry], shift.left[i, entry] = height, side, left
    return shift


def _peaks(
    limit: Limit,
    beyond: Float[np.ndarray, " finer"],
    rows: Float[np.ndarray, " limited"],
    places: Float[np.ndarray, " limited"],
    preferred: Sequence[Int[np.ndarray, " some"]],
    least: float,
) -> list[tuple[int, int, float, float]]:
    """The peaks of the finer grid that could break a limit, if parabolas through neighbouring rows tell them: the row
    closest to each, the side of the limit, the excess, and by how much that exceeds the parabola's.

    - `preferred`: rows that may limit peaks, those that do already first: until a peak leaves their parabolas;
    - `least`: what counts as an excess. A path that runs along its bound has peaks of rounding, which move with it.
    """
    every = dict[int, tuple[int, int, float, float]]()
    before, middle, after = beyond[:-2], beyond[1:-1], beyond[2:]
    for j in np.flatnonzero((middle > before) & (middle >= after)) + 1:
        step, bend = beyond[j + 1] - beyond[j - 1], beyond[j - 1] - 2 * beyond[j] + beyond[j + 1]
        place, height = j - step / (2 * bend), float(beyond[j] - step**2 / (8 * bend))
        near = [some[(places[some - 1] < place) & (place < places[some + 1])] for some in preferred]
        near = next((some for some in near if some.size), None)
        if near is None:
            continue
        i = int(near[np.argmin(np.abs(places[near] - place))])
        around = rows[i - 1 : i + 2]
        excess = excess_of(limit.constraint, around)
        if height + abs(height - excess[1]) <= least:
            continue
        side = 1 if excess[1] == around[1] - float(limit.constraint.upper) else -1
        value = extreme(places[i - 1 : i + 2], around, side).value
        left = height - float(excess_of(limit.constraint, np.asarray(value)))
        if abs(left) <= _MISSED * float(np.ptp(around)) and height > (every[i][2] if i in every else -np.inf):
            every[i] = i, side, height, left
    return [*every.values()]


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
            every.append(Margin(np.where(new.peaks == 0, moved, new.left), new.peaks))
        else:
            every.append(old._replace(by=old.by + 1.2 * np.maximum(new.by, 0.0)))
    return tuple(every)


def has_peaks(margins: Margins) -> bool:
    """Whether any row limits a peak."""
    return any(one is not None and one.peaks.any() for one in margins)


def narrows(transcribed: AbstractTranscribed, margins: Margins) -> bool:
    """Whether bounds are moved inwards at rows that limit no peak, which costs more than it has to."""
    each = zip(margins, transcribed.scales, strict=True)
    return any(one is not None and bool(np.any((one.by > HELD * size) & (one.peaks == 0))) for one, size in each)


def tightened(transcribed: AbstractTranscribed, margins: Margins) -> NonlinearProgram:
    """The program with its limits over time imposed as margins say."""
    program, peaks = transcribed.program, []
    lower, upper = program.constraint_lower.copy(), program.constraint_upper.copy()
    for one, rows, margin in zip(transcribed.problem.constraints, transcribed.rows, margins, strict=True):
        if margin is None:
            continue
        moved = margin.by.ravel()
        lower[rows], upper[rows] = lower[rows] + moved, upper[rows] - moved
        for i, entry in zip(*np.nonzero(margin.peaks), strict=True):
            places, width = transcribed.limited(path_of(one)), margin.by.shape[1]
            around = rows.start + np.arange(i - 1, i + 2) * width + entry
            peaks.append(Peak(around, places[i - 1 : i + 2], int(margin.peaks[i, entry])))
    program = replace(program, constraint_lower=lower, constraint_upper=upper)
    return with_peaks(program, peaks) if peaks else program
