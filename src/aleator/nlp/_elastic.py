"""Elastic programs, some of whose rows may be exceeded, by as little as possible in all."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from aleator.nlp._answer import HELD
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._solver import Outcome, Status

# The first excess of every group that may be exceeded, in sizes.
_FIRST = 1.0


class _Sides(NamedTuple):
    """Finite bounds as `sign c(x) - slack size <= most`: sign +1 for an upper bound, -1 for a lower one.

    `group`: the place of the elastic group of each, -1 for one that holds.
    """

    rows: Int[np.ndarray, " sides"]
    signs: Float[np.ndarray, " sides"]
    most: Float[np.ndarray, " sides"]
    group: Int[np.ndarray, " sides"]
    sizes: Float[np.ndarray, " sides"]


class Excess(NamedTuple):
    """The end of an elastic program.

    - `point`: of the program's variables, shape (n,);
    - `excesses`: of each group that may be exceeded, in sizes of its rows, as they are at the point, whatever the
      solver says; infinite where the other groups do not hold, or the model cannot be evaluated;
    - `pushing`: for each group of the program, the rows that hold others back, by their multipliers;
    - `bounds`: which variables are held back by a bound, shape (n,);
    - `outcome`: of the solver.
    """

    point: Float[np.ndarray, " n"]
    excesses: Float[np.ndarray, " elastic"]
    pushing: tuple[Int[np.ndarray, " some"], ...]
    bounds: np.ndarray
    outcome: Outcome

    @property
    def total(self) -> float:
        """The sum of all excesses; infinite where the others do not hold."""
        return float(self.excesses.sum())

    @property
    def is_shown(self) -> bool:
        """Whether the search ended where no small step lowers it, rather than where it could not go on."""
        return self.total <= HELD or self.outcome.status in (Status.SOLVED, Status.INFEASIBLE)


@final
@dataclass(frozen=True)
class Elastic:
    """The least total excess of some groups of a program's rows while others hold; further ones are left out.

    - `original`: the program; `groups`: the rows of each, with the size to which its excess is relative;
    - `held`, `loose`: the groups that hold, and those that may be exceeded.
    """

    original: NonlinearProgram
    groups: Sequence[tuple[Int[np.ndarray, " rows"], float]]
    held: Sequence[int]
    loose: Sequence[int]

    @property
    def program(self) -> NonlinearProgram:
        """The program to be solved: its variables are those of the original, then the excesses of the loose groups."""
        original, n, count, sides = self.original, self.original.start.size, len(self.loose), self._sides
        slacks = np.where(sides.group[:, None] == np.arange(count), -sides.sizes[:, None], 0.0)

        def evaluate(point: Float[np.ndarray, " m"]) -> Evaluation:
            there = original.evaluate(point[:n])
            slopes = sides.signs[:, None] * dense_rows(there.jacobian, sides.rows)
            return Evaluation(
                objective=float(point[n:].sum()),
                gradient=np.append(np.zeros(n), np.ones(count)),
                constraints=sides.signs * there.constraints[sides.rows] + slacks @ point[n:],
                jacobian=np.concatenate([slopes, slacks], axis=1),
            )

        return NonlinearProgram(
            evaluate=evaluate,
            start=np.append(original.start, np.full(count, _FIRST)),
            lower=np.append(original.lower, np.zeros(count)),
            upper=np.append(original.upper, np.full(count, np.inf)),
            constraint_lower=np.full(len(sides.rows), -np.inf),
            constraint_upper=sides.most,
            constraint_scale=sides.sizes,
            variable_scale=np.append(original.variable_scale, np.ones(count)),
            least=0.0,
        )

    def start(self, point: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """The start of this program at a point of the original, with excesses so large that the rows hold there."""
        excesses = self._excesses(point)
        return np.append(point, np.where(np.isfinite(excesses), excesses, _FIRST))

    def excess(self, outcome: Outcome) -> Excess:
        """The meaning of an outcome of this program."""
        n = self.original.start.size
        rows = set(self._sides.rows[outcome.active & (outcome.multipliers != 0)].tolist())
        return Excess(
            outcome.point[:n],
            self._excesses(outcome.point[:n]),
            tuple(np.array(sorted(rows & set(own.tolist())), dtype=int) for own, _ in self.groups),
            outcome.active_bounds[:n] & (self.original.lower < self.original.upper),
            outcome,
        )

    def _excesses(self, point: Float[np.ndarray, " n"]) -> Float[np.ndarray, " loose"]:
        """By how much each loose group is exceeded at a point; infinite where that is not known."""
        sides, original = self._sides, self.original
        values = original.evaluate(np.clip(point, original.lower, original.upper)).constraints
        beyond = (sides.signs * values[sides.rows] - sides.most) / sides.sizes
        excesses, loose = np.zeros(len(self.loose)), sides.group >= 0
        np.maximum.at(excesses, sides.group[loose], np.nan_to_num(beyond[loose], nan=np.inf))
        holds = np.isfinite(values).all() and np.all(beyond[~loose] <= HELD)
        return excesses if holds else np.full(len(self.loose), np.inf)

    @property
    def _sides(self) -> _Sides:
        limits, left_out = self.original.limits, -2
        group, sizes = np.full(limits.lower.size, left_out), np.ones(limits.lower.size)
        places = dict.fromkeys(self.held, -1) | {which: i for i, which in enumerate(self.loose)}
        for which, place in places.items():
            own, size = self.groups[which]
            group[own], sizes[own] = place, size
        rows, signs, most = limits.within(np.zeros(limits.lower.size))
        used = group[rows] != left_out
        rows = rows[used]
        return _Sides(rows, signs[used], most[used], group[rows], sizes[rows])
