"""Elastic programs, some of whose rows may be exceeded, by as little as possible in all."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._solver import AbstractSolver, Status
from aleator.nlp._verdict import HELD

# The first excess of every group that may be exceeded where its own is not known, in sizes.
_FIRST = 1.0
# The place among the loose groups of a row that holds, and of one that is left out.
_HELD, _LEFT_OUT = -1, -2


class Excess(NamedTuple):
    """The end of an elastic program.

    - `point`: of the program's variables, shape (n,);
    - `total`: the sum of the excesses of all groups that may be exceeded, in sizes of their rows, as they are at the
      point, whatever the solver says; infinite where the other groups do not hold, or the model cannot be evaluated;
    - `pushing`: for each group of the program, the rows that hold others back, by their multipliers;
    - `bounds`: which variables are held back by a bound, shape (n,);
    - `is_shown`: whether the search ended where no small step lowers the total, rather than where it could not go on.
    """

    point: Float[np.ndarray, " n"]
    total: float
    pushing: tuple[Int[np.ndarray, " some"], ...]
    bounds: Bool[np.ndarray, " n"]
    is_shown: bool


def least_excess(
    solver: AbstractSolver,
    program: NonlinearProgram,
    groups: Sequence[tuple[Int[np.ndarray, " rows"], float]],
    held: Sequence[int],
    loose: Sequence[int],
    starts: Sequence[Float[np.ndarray, " n"]],
) -> Excess:
    """The least total excess of some groups of a program's rows while others hold; further ones are left out.

    - `groups`: the rows of each, with the size to which its excess is relative;
    - `held`, `loose`: the groups that hold, and those that may be exceeded.

    The search ends at the first start from which all hold; of equally good ends, one that is shown is returned.
    """
    n, count = program.start.size, len(loose)
    place, size = np.full(program.limits.lower.size, _LEFT_OUT), np.ones(program.limits.lower.size)
    for which, its_place in (dict.fromkeys(held, _HELD) | {which: i for i, which in enumerate(loose)}).items():
        own, its_size = groups[which]
        place[own], size[own] = its_place, its_size
    # Finite bounds as `sign c(x) - excess size <= most`.
    rows, signs, most = program.limits.within(np.zeros(place.size))
    used = place[rows] != _LEFT_OUT
    rows, signs, most = rows[used], signs[used], most[used]
    place, size = place[rows], size[rows]
    slopes_of_excesses = np.where(place[:, None] == np.arange(count), -size[:, None], 0.0)

    def excesses(point: Float[np.ndarray, " n"]) -> Float[np.ndarray, " loose"]:
        values = program.evaluate(np.clip(point, program.lower, program.upper)).constraints
        beyond, found, is_loose = (signs * values[rows] - most) / size, np.zeros(count), place != _HELD
        np.maximum.at(found, place[is_loose], np.nan_to_num(beyond[is_loose], nan=np.inf))
        holds = np.isfinite(values).all() and np.all(beyond[~is_loose] <= HELD)
        return found if holds else np.full(count, np.inf)

    def evaluate(point: Float[np.ndarray, " m"]) -> Evaluation:
        there = program.evaluate(point[:n])
        return Evaluation(
            objective=float(point[n:].sum()),
            gradient=np.append(np.zeros(n), np.ones(count)),
            constraints=signs * there.constraints[rows] + slopes_of_excesses @ point[n:],
            jacobian=np.hstack([signs[:, None] * dense_rows(there.jacobian, rows), slopes_of_excesses]),
        )

    elastic = NonlinearProgram(
        evaluate=evaluate,
        start=np.append(program.start, np.full(count, _FIRST)),
        lower=np.append(program.lower, np.zeros(count)),
        upper=np.append(program.upper, np.full(count, np.inf)),
        constraint_lower=np.full(rows.size, -np.inf),
        constraint_upper=most,
        constraint_scale=size,
        variable_scale=np.append(program.variable_scale, np.ones(count)),
        least=0.0,
    )
    ends: list[Excess] = []
    for start in starts:
        known = excesses(start)
        outcome = solver.solve(elastic, start=np.append(start, np.where(np.isfinite(known), known, _FIRST)))
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        total = float(excesses(outcome.point[:n]).sum())
        pushing = rows[outcome.active & (outcome.multipliers != 0)]
        ends.append(
            Excess(
                outcome.point[:n],
                total,
                tuple(np.intersect1d(own, pushing) for own, _ in groups),
                outcome.active_bounds[:n] & (program.lower < program.upper),
                total <= HELD or outcome.status in (Status.SOLVED, Status.INFEASIBLE),
            )
        )
        if total <= HELD:
            break
    return min(ends, key=lambda end: (end.total, not end.is_shown))
