"""Limits between the instants of the grid: how far a solution exceeds them there, and margins that make it hold."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.certification._jumps import jumps, knots, one_sided
from aleator.certification._reference import Reference, bound_size
from aleator.design import Constraint, is_over_time
from aleator.nlp import NonlinearProgram
from aleator.transcription import AbstractTranscribed

Margins = tuple[Float[np.ndarray, " instants"] | None, ...]


class Excess(NamedTuple):
    """How far limits over time are exceeded on a finer grid.

    - `shifts`: of each constraint that limits a path or a peak, by how much its bound is to move inwards at each
      instant for the worst value beside it to meet the bound, negative where it may move outwards; None for others;
    - `worst`: the largest excess of a limit over time, relative to its bound (to the constraint's scale where that is
      zero), or zero; `where`: its constraint, `when`: its time, s.
    """

    shifts: Margins
    worst: float
    where: str
    when: float


def excess_between(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], finer: Reference
) -> Excess:
    """How far a problem's limits over time are exceeded on a finer grid."""
    problem, factor = transcribed.problem, finer.factor
    meaning = transcribed.at(point)
    shifts: list[Float[np.ndarray, " instants"] | None] = []
    worst = (0.0, "", 0.0)
    at = knots(problem, meaning.decisions)
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
        # A number that is none is beyond all.
        largest, place = max((np.inf if np.isnan(excess) else excess, place) for excess, place in candidates)
        if largest / scale > worst[0]:
            worst = largest / scale, one.name, float(meaning.times[place // factor]) if one.is_path else np.nan
        if float(one.lower) == float(one.upper):
            shifts[-1] = None  # no margin makes both sides hold
    return Excess(tuple(shifts), *worst)


def _excess(constraint: Constraint, values: Float[np.ndarray, "rows entries"]) -> Float[np.ndarray, " rows"]:
    """How far each row is beyond a constraint's bounds at worst."""
    return np.maximum(values - float(constraint.upper), float(constraint.lower) - values).max(axis=1)


def _shifts(
    beyond: Float[np.ndarray, " finer"], factor: int, sides: list[tuple[float, float, float]]
) -> Float[np.ndarray, " instants"]:
    """What the worst value in each interval asks of its two ends, in proportion to how close they are.

    Shifts `e (1 - s)` and `e s` over their squares' sum change a straight line between them by `e` at the fraction `s`.
    An end beyond a jump has no part in that; `sides` are the jumps, with the excess before and after.
    """
    places = np.arange(0, len(beyond) - 1, factor)[:, None] + np.arange(factor + 1)[None, :]
    inside = beyond[places]
    worst = np.argmax(inside, axis=1)
    excess = inside[np.arange(len(inside)), worst]
    s = worst / factor
    share = np.stack([1 - s, s]) / ((1 - s) ** 2 + s**2)
    first, last = np.where(excess > 0, share * excess, excess)
    one_sided(first, last, inside, sides)
    return np.maximum(np.append(first, -np.inf), np.append(-np.inf, last))


def no_margins(excess: Excess) -> Margins:
    """Margins to begin with."""
    return tuple(None if one is None else np.zeros(len(one)) for one in excess.shifts)


def margins_for(margins: Margins, excess: Excess, *, relax: bool) -> Margins:
    """Margins that follow the excess. With `relax` they shrink where limits hold, so that nothing is given away."""
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
