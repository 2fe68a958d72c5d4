"""Limits between the instants of the grid: how far a solution exceeds them, and margins that enforce them.

At the knots of trajectories outputs may jump, such as torques of a motion of degree 2. An instant has the value of one
side of a jump only, so that the sides before and after it are judged separately.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import Check, splines_in
from aleator.design import Constraint, Problem, is_over_time
from aleator.nlp import NonlinearProgram
from aleator.trajectories import piecewise_in
from aleator.transcription import AbstractTranscribed, bound_size
from aleator.uncertainty import at_means, realise

# A jump exceeds this many changes between neighbouring fine instants, and this part of the values.
_STEEP, _LEAST = 5.0, 1e-6
# A knot within this many steps of an instant coincides with it up to rounding.
_AT = 1e-6

Margins = tuple[Float[np.ndarray, " instants"] | None, ...]
"""By how much the bounds of each constraint are moved inwards at each instant; None for limits on no path or peak."""


class Excess(NamedTuple):
    """How far limits over time are exceeded on a finer grid.

    - `shifts`: for each constraint that limits a path or a peak, how far its bound must move inwards at each instant
      so that the worst value near it meets the bound, negative if it may move outwards; None for other constraints;
    - `worst`: the largest excess of a limit over time, relative to its bound (to the constraint's scale if that is
      zero), or zero; `where`: its constraint; `when`: its time, s.
    """

    shifts: Margins
    worst: float
    where: str
    when: float


def excess_between(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], finer: Check) -> Excess:
    """How far a problem's limits over time are exceeded on a finer grid."""
    problem, factor = transcribed.problem, finer.factor
    meaning = transcribed.at(point)
    shifts: list[Float[np.ndarray, " instants"] | None] = []
    worst = (0.0, "", 0.0)
    at = _knots(problem, meaning.decisions)
    for one, value, scale in zip(problem.constraints, finer.values[1:], transcribed.scales, strict=True):
        scale = bound_size(one) or scale
        if not is_over_time(one):
            shifts.append(None)
            continue
        flat = value.reshape(len(value) if one.is_path else 1, -1)
        rows = _excess(one, flat)
        sides = [
            (jump.place, float(_excess(one, jump.before[None])[0]), float(_excess(one, jump.after[None])[0]))
            for jump in (jumps(flat, at) if one.is_path else [])
        ]
        shifts.append(_shifts(rows, factor, sides) if one.is_path else rows)
        candidates = [(float(rows.max()), int(np.argmax(rows))), *((max(side[1:]), int(side[0])) for side in sides)]
        # NaN counts as the largest excess.
        largest, place = max((np.inf if np.isnan(excess) else excess, place) for excess, place in candidates)
        if largest / scale > worst[0]:
            worst = largest / scale, one.name, float(meaning.times[place // factor]) if one.is_path else np.nan
        if float(one.lower) == float(one.upper):
            shifts[-1] = None  # no margin can enforce both sides of an equality
    return Excess(tuple(shifts), *worst)


def _excess(constraint: Constraint, values: Float[np.ndarray, "rows entries"]) -> Float[np.ndarray, " rows"]:
    """The largest excess of each row over a constraint's bounds."""
    return np.maximum(values - float(constraint.upper), float(constraint.lower) - values).max(axis=1)


def _shifts(
    beyond: Float[np.ndarray, " finer"], factor: int, sides: list[tuple[float, float, float]]
) -> Float[np.ndarray, " instants"]:
    """The shifts at both ends of each interval that its worst value requires, in proportion to their proximity.

    Shifts `e (1 - s)` and `e s`, divided by `(1 - s)² + s²`, change a straight line between them by `e` at the fraction
    `s`. An end beyond a jump does not count; `sides` are the jumps, with the excess before and after.
    """
    places = np.arange(0, len(beyond) - 1, factor)[:, None] + np.arange(factor + 1)[None, :]
    inside = beyond[places]
    worst = np.argmax(inside, axis=1)
    excess = inside[np.arange(len(inside)), worst]
    s = worst / factor
    share = np.stack([1 - s, s]) / ((1 - s) ** 2 + s**2)
    first, last = np.where(excess > 0, share * excess, excess)
    _one_sided(first, last, inside, sides)
    return np.maximum(np.append(first, -np.inf), np.append(-np.inf, last))


def no_margins(excess: Excess) -> Margins:
    """The initial margins: zero."""
    return tuple(None if one is None else np.zeros(len(one)) for one in excess.shifts)


def margins_for(margins: Margins, excess: Excess, *, relax: bool) -> Margins:
    """Margins updated by the excess. With `relax` they shrink where limits hold with slack."""
    return tuple(
        None if old is None or new is None else np.maximum(old + (new if relax else 1.2 * np.maximum(new, 0.0)), 0.0)
        for old, new in zip(margins, excess.shifts, strict=True)
    )


def tightened(transcribed: AbstractTranscribed, margins: Margins) -> NonlinearProgram:
    """The program with the bounds of path constraints moved inwards by margins."""
    program = transcribed.program
    lower, upper = program.constraint_lower.copy(), program.constraint_upper.copy()
    for rows, margin in zip(transcribed.rows, margins, strict=True):
        if margin is not None:
            moved = np.repeat(margin, (rows.stop - rows.start) // len(margin))
            lower[rows], upper[rows] = lower[rows] + moved, upper[rows] - moved
    return replace(program, constraint_lower=lower, constraint_upper=upper)


class Jump(NamedTuple):
    """One jump of a path: its place in steps of the finer grid, and the values on both sides, shape (entries,)."""

    place: float
    before: Float[np.ndarray, " entries"]
    after: Float[np.ndarray, " entries"]


def _knots(problem: Problem, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " knots"]:
    """The interior knots of splines and nodes of controls at some decisions, as fractions of a problem's time."""
    model = realise(at_means(problem.simulation), jax_array(np.zeros(0)), jax_array(decisions))
    parts = model.system, model.inputs
    ends = (one.breaks() for one in (*splines_in(parts), *piecewise_in(parts)))
    fractions = np.concatenate([np.zeros(0), *ends])
    return np.unique(fractions[(fractions > 0) & (fractions < 1)])


def jumps(values: Float[np.ndarray, "finer entries"], at: Float[np.ndarray, " knots"]) -> list[Jump]:
    """The jumps of a path at knots, from linear extrapolation on both sides."""
    jumps_there = []
    last, size = len(values) - 1, float(np.abs(values).max(initial=0.0))
    for place in at * last:
        left, right = int(np.ceil(place - _AT)) - 1, int(np.floor(place + _AT)) + 1
        if left < 1 or right > last - 1:
            continue
        rising, going = values[left] - values[left - 1], values[right + 1] - values[right]
        before, after = values[left] + rising * (place - left), values[right] - going * (right - place)
        change = max(float(np.abs(rising).max()), float(np.abs(going).max()))
        if float(np.abs(after - before).max()) > _STEEP * change + _LEAST * size:
            jumps_there.append(Jump(float(place), before, after))
    return jumps_there


def _one_sided(
    first: Float[np.ndarray, " intervals"],
    last: Float[np.ndarray, " intervals"],
    inside: Float[np.ndarray, "intervals fine"],
    sides: list[tuple[float, float, float]],
) -> None:
    """Let each end of an interval with a jump account for its own side only; changes `first` and `last` in place.

    - `first`, `last`: the shifts required at the left and right ends of intervals; `inside`: the excess at fine
      instants;
    - `sides`: jumps, as place in fine steps and excess before and after.
    """
    factor = inside.shape[1] - 1
    for i in sorted({j for place, _, _ in sides for j in _intervals(place / factor, len(inside))}):
        here = [(place / factor - i, before, after) for place, before, after in sides]
        here = [side for side in here if -_AT <= side[0] <= 1 + _AT]
        fine = np.arange(factor + 1) / factor
        earliest, latest = min(side[0] for side in here), max(side[0] for side in here)
        # Exactly at a jump, rounding decides which side an instant's value belongs to.
        left = inside[i][fine < earliest - _AT].tolist() + [before for at, before, _ in here if at == earliest]
        right = inside[i][fine > latest + _AT].tolist() + [after for at, _, after in here if at == latest]
        first[i] = max(left) if earliest > _AT else -np.inf
        last[i] = max(right) if latest < 1 - _AT else -np.inf


def _intervals(place: float, count: int) -> set[int]:
    """The intervals that contain a place, in steps: two if it is an instant."""
    return {i for i in (int(np.floor(place - _AT)), int(np.floor(place + _AT))) if 0 <= i < count}
