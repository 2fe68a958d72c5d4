"""The search for feasible points: further starts before a program is called infeasible, and elastic programs, whose
rows may be exceeded by as little as possible in all.

Solvers prove that no small step from their point meets all constraints. There may still be a feasible point elsewhere:
if a model saturates, or if a variable must change by many orders of magnitude from a poor start.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from aleator.nlp._answer import HELD
from aleator.nlp._matrices import dense_rows
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._solver import AbstractSolver, Outcome, Status

# How many points in the whole range of the variables are evaluated, and how far from the start an unbounded range
# extends, in typical magnitudes.
_POINTS, _FAR = 8, 3.0
# Bounds that are so many typical magnitudes, or units, away stand for none.
UNBOUNDED = 1e15
# A violation is lower if it is so by more than this part.
_LESS = 1e-2


def feasible_elsewhere(
    program: NonlinearProgram,
    outcome: Outcome,
    start: np.ndarray,
    again: Callable[[NonlinearProgram, np.ndarray], Outcome],
) -> Outcome:
    """The outcome, or that from another start if it is infeasible although some other point violates less.

    `again` solves a program from a start: the least violated of the points evaluated, which include `start` (shape
    (n,)) and the program's own, with variables scaled by their values there. A search that strayed from points that
    meet all constraints starts from the best of these. Where a point meets them, the outcome is not infeasible.
    """
    if outcome.strayed:
        best, is_feasible = outcome.point, True
    elif outcome.status is Status.INFEASIBLE:
        points = [start, program.start, *_points(program, start)]
        violations = [_violation(program, outcome, point) for point in points]
        least = int(np.argmin(violations))
        if not violations[least] < (1 - _LESS) * outcome.violation:
            return outcome
        best, is_feasible = points[least], violations[least] <= HELD
    else:
        return outcome
    scale = np.max(np.abs([program.variable_scale, outcome.point, best]), axis=0)
    found = again(replace(program, variable_scale=scale), best)
    if found.status in (Status.SOLVED, Status.INTERRUPTED) or (is_feasible and _is_better(found, outcome)):
        return found.with_effort_of(outcome)
    return outcome.with_effort_of(found)


def _is_better(found: Outcome, outcome: Outcome) -> bool:
    """Whether an outcome whose search began at a feasible point tells more than the one before it."""
    if not outcome.strayed:
        return found.status is not Status.INFEASIBLE
    return found.violation <= HELD and found.evaluation.objective < outcome.evaluation.objective


def variable_range(
    start: np.ndarray, lower: np.ndarray, upper: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest values of the variables, or three typical magnitudes from the start if unbounded."""
    far, bounded = _FAR * scale, UNBOUNDED * np.maximum(scale, 1.0)
    return np.where(lower > -bounded, lower, start - far), np.where(upper < bounded, upper, start + far)


def _points(program: NonlinearProgram, start: np.ndarray) -> list[np.ndarray]:
    """The corners of least and of greatest values, the middle between them, and points in the whole range."""
    lower, upper = variable_range(start, program.lower, program.upper, program.variable_scale)
    generator = np.random.default_rng(0)
    return [lower, upper, (lower + upper) / 2, *generator.uniform(lower, upper, (_POINTS, len(start)))]


def _violation(program: NonlinearProgram, outcome: Outcome, point: np.ndarray) -> float:
    values = program.evaluate(point).constraints
    beyond = np.maximum(values - program.constraint_upper, program.constraint_lower - values) / outcome.sizes
    return float(np.max(beyond, initial=0.0)) if np.isfinite(values).all() else np.inf


# The first excess of every group that may be exceeded, in sizes.
_FIRST = 1.0


class _Sides(NamedTuple):
    """Finite bounds as `sign c(x) - slack size <= sign bound`: sign +1 for an upper bound, -1 for a lower one."""

    rows: Int[np.ndarray, " sides"]
    signs: Float[np.ndarray, " sides"]
    bounds: Float[np.ndarray, " sides"]
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
class Elastic:
    """A program's constraints in groups, of which some are left out, some may be exceeded, and the others hold.

    `groups`: the rows of each, with the size to which its excess is relative.
    """

    def __init__(self, program: NonlinearProgram, groups: Sequence[tuple[Int[np.ndarray, " rows"], float]]):
        self._program, self._groups = program, groups

    def least(
        self, solver: AbstractSolver, held: Sequence[int], elastic: Sequence[int], starts: Sequence[np.ndarray]
    ) -> Excess:
        """The least total excess of the `elastic` groups while the groups `held` hold; others are left out.

        `starts`: shape (n,) each; the search ends at the first one from which all groups hold. Of others that are
        equally good, one that is shown to be least is returned.
        """
        program, sides = self._program_of(held, elastic)
        found: list[Excess] = []
        for start in starts:
            outcome = solver.solve(program, start=np.append(start, self._first(start, sides, len(elastic))))
            found.append(self._ended(outcome, sides, len(elastic)))
            if outcome.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if found[-1].total <= HELD:
                break
        return min(found, key=lambda one: (one.total, not one.is_shown))

    def _first(self, start: Float[np.ndarray, " n"], sides: _Sides, count: int) -> Float[np.ndarray, " elastic"]:
        """The excesses of the groups at a start, so that these hold there."""
        excesses = self._beyond(start, sides, count)
        return np.where(np.isfinite(excesses), excesses, _FIRST)

    def _beyond(self, point: Float[np.ndarray, " n"], sides: _Sides, count: int) -> Float[np.ndarray, " elastic"]:
        """By how much each elastic group is exceeded at a point; infinite where that is not known."""
        found = self._program.evaluate(np.clip(point, self._program.lower, self._program.upper)).constraints
        beyond = (sides.signs * (found[sides.rows] - sides.bounds)) / sides.sizes
        excesses, loose = np.zeros(count), sides.group >= 0
        np.maximum.at(excesses, sides.group[loose], np.nan_to_num(beyond[loose], nan=np.inf))
        held = np.isfinite(found).all() and np.all(beyond[~loose] <= HELD)
        return excesses if held else np.full(count, np.inf)

    def _program_of(self, held: Sequence[int], elastic: Sequence[int]) -> tuple[NonlinearProgram, _Sides]:
        program, n, count = self._program, self._program.start.size, len(elastic)
        sides = self._sides(held, elastic)
        slacks = np.zeros((len(sides.rows), count))
        loose = np.flatnonzero(sides.group >= 0)
        slacks[loose, sides.group[loose]] = -sides.sizes[loose]

        def evaluate(point: Float[np.ndarray, " m"]) -> Evaluation:
            found = program.evaluate(point[:n])
            slopes = sides.signs[:, None] * dense_rows(found.jacobian, sides.rows)
            return Evaluation(
                objective=float(point[n:].sum()),
                gradient=np.append(np.zeros(n), np.ones(count)),
                constraints=sides.signs * found.constraints[sides.rows] + slacks @ point[n:],
                jacobian=np.concatenate([slopes, slacks], axis=1),
            )

        return NonlinearProgram(
            evaluate=evaluate,
            start=np.append(program.start, np.full(count, _FIRST)),
            lower=np.append(program.lower, np.zeros(count)),
            upper=np.append(program.upper, np.full(count, np.inf)),
            constraint_lower=np.full(len(sides.rows), -np.inf),
            constraint_upper=sides.signs * sides.bounds,
            constraint_scale=sides.sizes,
            variable_scale=np.append(program.variable_scale, np.ones(count)),
            least=0.0,
        ), sides

    def _ended(self, outcome: Outcome, sides: _Sides, count: int) -> Excess:
        """The meaning of the outcome of such a program."""
        n = self._program.start.size
        active = outcome.active & (outcome.multipliers != 0)
        rows = set(sides.rows[active].tolist())
        return Excess(
            outcome.point[:n],
            self._beyond(outcome.point[:n], sides, count),
            tuple(np.array(sorted(rows & set(own.tolist())), dtype=int) for own, _ in self._groups),
            outcome.active_bounds[:n] & (self._program.lower < self._program.upper),
            outcome,
        )

    def _sides(self, held: Sequence[int], elastic: Sequence[int]) -> _Sides:
        program, parts = self._program, []
        places = {which: i for i, which in enumerate(elastic)}
        for which in sorted({*held, *elastic}):
            rows, size = self._groups[which]
            for sign, bounds in ((1.0, program.constraint_upper), (-1.0, program.constraint_lower)):
                some = rows[np.isfinite(bounds[rows])]
                group = np.full(len(some), places.get(which, -1))
                parts.append((some, np.full(len(some), sign), bounds[some], group, np.full(len(some), size)))
        nothing = (np.zeros(0, dtype=int), np.zeros(0), np.zeros(0), np.zeros(0, dtype=int), np.zeros(0))
        return _Sides(*map(np.concatenate, zip(nothing, *parts, strict=True)))
