"""Limits between the instants of the grid: how far a solution exceeds them, and margins that enforce them."""

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

    - `shifts`: for each constraint that limits a path or a peak, how far its bound must move inwards at each instant
      so that the worst value near it meets the bound, negative if it may move outwards; None for other constraints;
    - `worst`: the largest excess of a limit over time, relative to its bound (to the constraint's scale if that is
      zero), or zero; `where`: its constraint; `when`: its time, s.
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
    one_sided(first, last, inside, sides)
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
