"""Limits over time between the instants, by CHECK: how far they are exceeded there, and the margins that enforce them.

Bounds are tightened by what is exceeded. In the end rows limit peaks, and the values beside jumps, instead of their
own: so the answer does not depend on where the instants are, and its multipliers are slopes of the optimum.

At the knots of trajectories and controls outputs may jump, such as torques of a motion of degree 2. An instant has the
value after a jump only, so that the sides before and after it are judged separately.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import Check
from aleator.certification._fresh import parts_in
from aleator.certification._limits import limits_at
from aleator.certification._paths import LimitedPath, Shift, Which, jumps
from aleator.design import is_over_time, path_of
from aleator.dynamics import Simulation
from aleator.nlp import HELD, End, NonlinearProgram, Peak, with_peaks
from aleator.solution import Between
from aleator.trajectories import BSpline, jumping_in, piecewise_in
from aleator.transcription import AbstractTranscribed, bound_size, excess_of
from aleator.uncertainty import at_means, realise


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
    each = limits_at(check), transcribed.scales, check.meaning.constraints, margins or [None] * len(transcribed.rows)
    for limit, scale, rows, margin in zip(*each, strict=True):
        one, shift, path = limit.constraint, None, path_of(limit.constraint)
        if is_over_time(one):
            beyond, last, size = excess_of(one, limit.fine), len(limit.fine) - 1, bound_size(one) or scale
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


def narrows(transcribed: AbstractTranscribed, margins: Margins) -> bool:
    """Whether bounds are moved inwards at rows that limit their own values, which costs more than it has to."""
    each = zip(margins, transcribed.scales, strict=True)
    moved = ((one, np.argwhere(one.by > HELD * size).tolist()) for one, size in each if one is not None)
    return any(tuple(which) not in one.instead for one, every in moved for which in every)


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
