"""Limits between the instants of the grid: how far a solution exceeds them there, and margins that make it hold."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.collocation import Collocation
from aleator.design import Constraint, Problem, functionals_of, is_over_time
from aleator.dynamics import Grid
from aleator.nlp import NonlinearProgram
from aleator.statistics import Constants
from aleator.transcription._scope import scope_of
from aleator.transcription._sequential import Sequential

Margins = tuple[Float[np.ndarray, " instants"] | None, ...]


class Excess(NamedTuple):
    """How far the constraints are exceeded on a finer grid, and how far those change that are no limits over time.

    - `shifts`: of each constraint that limits a path or a peak, by how much its bound is to move inwards at each
      instant for the worst value beside it to meet the bound, negative where it may move outwards; None for others;
    - `worst`: the largest excess of a limit over time, relative to its bound (to the constraint's scale where that is
      zero), or zero; `where`: its constraint, `when`: its time, s;
    - `change`: the largest change of any other constraint's value, relative likewise; `changed`: which it is.
    """

    shifts: Margins
    worst: float
    where: str
    when: float
    change: float
    changed: str


def _constraint_values(
    problem: Problem, collocation: Collocation, constants: Constants, decisions: Float[Array, " n"]
) -> tuple[Array, ...]:
    functionals = functionals_of(tuple(one.expression for one in problem.constraints))
    scope = scope_of(problem, functionals, collocation, constants, decisions)
    return tuple(jnp.asarray(one.expression.evaluate(scope)) for one in problem.constraints)


CONSTRAINT_VALUES = Compiled(_constraint_values)


def excess_between(transcription: Sequential, decisions: Float[np.ndarray, " n"], factor: int) -> Excess:
    """How far a problem's path constraints are exceeded on a grid of `factor` times as many steps."""
    problem = transcription.problem
    grid = problem.grid
    assert isinstance(grid, Grid)
    finer = eqx.tree_at(lambda tree: tree.grid, problem, grid.finer(factor))
    arguments = numbers_to_arrays(finer), transcription.collocation, transcription.constants
    values = CONSTRAINT_VALUES(*arguments, jnp.asarray(decisions))
    times, before = transcription.times(decisions), transcription.constraints(decisions)
    shifts: list[Float[np.ndarray, " instants"] | None] = []
    worst, change = (0.0, "", 0.0), (0.0, "")
    for one, value, old, scale in zip(problem.constraints, values, before, transcription.scales, strict=True):
        scale = _bound_size(one) or scale
        if not is_over_time(one):
            shifts.append(None)
            change = max(change, (float(np.max(np.abs(np.ravel(value) - old))) / scale, one.name))
            continue
        beyond = np.maximum(np.asarray(value) - float(one.upper), float(one.lower) - np.asarray(value))
        rows = beyond.reshape(len(beyond) if one.is_path else 1, -1).max(axis=1)
        shifts.append(_shifts(rows, factor) if one.is_path else rows)
        if rows.max() / scale > worst[0]:
            when = times[int(np.argmax(rows)) // factor] if one.is_path else np.nan
            worst = float(rows.max() / scale), one.name, float(when)
        if float(one.lower) == float(one.upper):
            shifts[-1] = None  # no margin makes both sides hold
    return Excess(tuple(shifts), *worst, *change)


def _bound_size(constraint: Constraint) -> float:
    """The smaller of a constraint's bounds in magnitude; zero where one of them is zero, which says nothing of
    sizes.
    """
    return min(abs(bound) for bound in map(float, (constraint.lower, constraint.upper)) if np.isfinite(bound))


def _shifts(beyond: Float[np.ndarray, " finer"], factor: int) -> Float[np.ndarray, " instants"]:
    """What the worst value in each interval asks of its two ends, in proportion to how close they are.

    Shifts `e (1 - s)` and `e s` over their squares' sum change a straight line between them by `e` at the fraction `s`.
    """
    places = np.arange(0, len(beyond) - 1, factor)[:, None] + np.arange(factor + 1)[None, :]
    inside = beyond[places]
    worst = np.argmax(inside, axis=1)
    excess = inside[np.arange(len(inside)), worst]
    s = worst / factor
    share = np.stack([1 - s, s]) / ((1 - s) ** 2 + s**2)
    first, last = np.where(excess > 0, share * excess, excess)
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


def tightened(transcription: Sequential, margins: Margins) -> NonlinearProgram:
    """The program with the bounds of path constraints moved inwards by margins."""
    program = transcription.program
    lower, upper = program.constraint_lower.copy(), program.constraint_upper.copy()
    for rows, margin in zip(transcription.rows, margins, strict=True):
        if margin is not None:
            moved = np.repeat(margin, (rows.stop - rows.start) // len(margin))
            lower[rows], upper[rows] = lower[rows] + moved, upper[rows] - moved
    return replace(program, constraint_lower=lower, constraint_upper=upper)
