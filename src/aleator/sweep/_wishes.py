"""One problem for every compromise between several wishes: its numbers choose which."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator._core.errors import ProblemError
from aleator.design import Constraint, Expression, Problem, as_expression, declared_anew, pure, value
from aleator.solution import Solution
from aleator.transcription import AbstractTranscribed
from aleator.uncertainty import Decision

# The decision to which all wishes are pressed down together, and the name of the constraint on their weighted sum.
_OWN = "trade-off: "
LEVEL, WEIGHTED = "trade-off.level", f"{_OWN}weighted sum"
# The share of all wishes in the objective, so that no wish is left worse than it need be.
_SHARE = 1e-4


def pressed(name: str) -> str:
    """The name of the constraint that presses one wish down."""
    return f"{_OWN}wish {name}"


def refuse_own_names(problem: Problem) -> None:
    """Raise `ProblemError` for a problem that uses the names by which places on a front are chosen."""
    own = [name for name in problem.names if name.startswith(_OWN)]
    own += [name for name in problem.placements.decisions if name == LEVEL]
    if own:
        raise ProblemError(f"trade_off: problem: the name '{own[0]}' is one of trade_off's own: use another.")


class _Numbers(NamedTuple):
    """The numbers `s`, `a`, `r`, `w`, `b` and `δ` of `Wishes`."""

    scales: Float[np.ndarray, " wishes"]
    offsets: Float[np.ndarray, " wishes"]
    directions: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, " wishes"]
    bound: float
    share: float


class Compromise(NamedTuple):
    """A problem that leads to one point of a front, and the numbers that chose it."""

    problem: Problem
    names: tuple[str, ...]
    numbers: _Numbers

    def values(self, solution: Solution) -> Float[np.ndarray, " wishes"]:
        """The wishes at its solution, in their own units."""
        level, by_name = solution.decisions[LEVEL], {one.name: one for one in solution.constraints}
        rows = np.array([float(np.ravel(by_name[pressed(name)].values)[0]) for name in self.names])
        return (rows + self.numbers.directions * level) / self.numbers.scales

    def weights(self, solution: Solution) -> Float[np.ndarray, " wishes"]:
        """How much each wish counts at its solution, per unit of its own."""
        numbers = self.numbers
        rows = np.array([solution.multiplier(pressed(name)) for name in self.names])
        weighted = solution.multiplier(WEIGHTED) * numbers.weights
        return numbers.scales * (rows + weighted + numbers.share)

    def away(self, values: Float[np.ndarray, " wishes"]) -> Float[np.ndarray, " wishes"]:
        """By how much a design's wishes differ from where this one is to be, in scaled wishes."""
        away = values * self.numbers.scales - self.numbers.offsets
        if self.numbers.directions.all():
            return away - away.mean()
        return np.where(np.isfinite(away) & (self.numbers.directions == 0), away, 0.0)

    def distance(self, values: Float[np.ndarray, " wishes"]) -> float:
        """How far a design's wishes are from where this one is to be, in scaled wishes."""
        return float(np.ptp(np.append(self.away(values), 0.0)))

    def design(self, solution: Solution) -> "Design":
        """Its solution, with the wishes there."""
        weights = self.weights(solution)
        return Design(solution, self.values(solution), weights, weights)


class Design(NamedTuple):
    """A design that was found.

    - `solution`: of the problem that led there; `values`: the wishes, in their own units;
    - `weights`: how much they count there, NaN where that is not known; `factors`: a sum of the wishes with these is
      stationary there.
    """

    solution: Solution
    values: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, " wishes"]
    factors: Float[np.ndarray, " wishes"]


@final
class Wishes:
    """A problem whose objective is replaced by a level `t` above several wishes `f`, in scales `s` of these:

        minimise t + δ Σ s_k f_k   subject to   s_k f_k - r_k t <= a_k for each k,   Σ w_k s_k f_k - t <= b.

    The numbers `a`, `r`, `w`, `b` choose one point of the front: along a direction (Pascoletti and Serafini 1984), one
    wish within limits on the others (Haimes et al. 1971), or a weighted sum. The small `δ` rules out points at which a
    wish could be better at no cost (Mavrotas 2009). All are data, so that one program serves the whole front.
    """

    def __init__(self, problem: Problem, wishes: Mapping[str, Expression]):
        self.names = tuple(wishes)
        self._given = problem
        self.expressions = tuple(as_expression(one) for one in wishes.values())
        # Scales and weights carry units.
        self._terms = tuple(map(pure, self.expressions))
        ones = np.ones(len(wishes))
        self._summed = declared_anew(problem, problem.simulation, minimize=self._sum(ones))
        first = _Numbers(ones, ones, ones, ones, 1.0, 1.0)
        self._problem = declared_anew(
            problem,
            problem.simulation,
            minimize=self._objective(first),
            subject_to=(*problem.constraints, *self._constraints(first)),
            decisions={LEVEL: Decision(1.0)},
        )

    def unscaled(self) -> "Compromise":
        """The wishes as they are, of which none is pressed down."""
        ones = np.ones(len(self.names))
        return self._with(_Numbers(ones, np.inf * ones, 0.0 * ones, 0.0 * ones, np.inf, 0.0))

    def places(self, problem: Problem) -> list[int]:
        """Which constraints of the problem of a compromise press the wishes down."""
        names = [one.name for one in problem.constraints]
        return [names.index(pressed(name)) for name in self.names]

    def rows(self, transcribed: AbstractTranscribed) -> Int[np.ndarray, " wishes"]:
        """The rows of these in its program."""
        return np.array([transcribed.rows[i].start for i in self.places(transcribed.problem)])

    def told(self, design: Design) -> Solution:
        """A design as the solution of the problem that was given, with the sum of the wishes as its objective.

        Whatever led there is a stationary point of that sum: what was added to choose a place is left out.
        """
        solution, own = design.solution, len(self._given.constraints)
        problem = eqx.tree_at(lambda one: one.objective, self._summed, self._sum(design.factors))
        whole, rows = solution.problem.placements, sum(one.multipliers.size for one in solution.constraints)
        kept = np.array([name != LEVEL for name in whole.entry_names()])
        # States that are variables bring rows of their own.
        is_all = rows == solution.multipliers.size
        return replace(
            solution,
            problem=problem,
            objective=float(design.factors @ design.values),
            decisions=without_level(solution.decisions),
            vector=solution.vector[kept],
            constraints=solution.constraints[:own],
            at_bounds=tuple(name for name in solution.at_bounds if name != LEVEL),
            idle=tuple(name for name in solution.idle if name != LEVEL),
            multipliers=solution.multipliers[: rows - len(self.names) - 1] if is_all else np.zeros(0),
            bound_multipliers=without_level(solution.bound_multipliers),
        )

    def only(self, which: int) -> Problem:
        """The problem with one wish as its objective, without any others."""
        return declared_anew(self._given, self._given.simulation, minimize=self.expressions[which])

    def least(self, which: int, scales: Float[np.ndarray, " wishes"]) -> "Compromise":
        """One wish alone: the others do not count."""
        compromise = self.within(which, np.full(len(self.names), np.inf), scales)
        return self._with(compromise.numbers._replace(share=0.0))

    def held(self, which: int, most: float, scales: Float[np.ndarray, " wishes"]) -> "Compromise":
        """The sum of the other wishes, with one of at most so much in its own unit."""
        one = np.arange(len(self.names)) == which
        offsets = np.where(one, scales * most, np.inf)
        return self._with(_Numbers(scales, offsets, 0.0 * scales, (~one).astype(float), 0.0, 0.0))

    def within(
        self,
        which: int,
        limits: Float[np.ndarray, " wishes"],
        scales: Float[np.ndarray, " wishes"],
    ) -> "Compromise":
        """One wish within limits on the others, which are in the wishes' own units."""
        one = np.arange(len(self.names)) == which
        offsets = np.where(one, 0.0, scales * limits)
        return self._with(_Numbers(scales, offsets, one.astype(float), 0.0 * scales, np.inf, _SHARE))

    def along(self, start: Float[np.ndarray, " wishes"], scales: Float[np.ndarray, " wishes"]) -> "Compromise":
        """The last point of a line through `start`, in the wishes' own units, on which all get better alike."""
        return self._with(_Numbers(scales, scales * start, np.ones(len(scales)), 0.0 * scales, np.inf, _SHARE))

    def weighted(self, weights: Float[np.ndarray, " wishes"], scales: Float[np.ndarray, " wishes"]) -> "Compromise":
        """A weighted sum of the wishes."""
        unbounded = np.full(len(scales), np.inf)
        return self._with(_Numbers(scales, unbounded, 0.0 * scales, weights, 0.0, _SHARE))

    def _with(self, numbers: "_Numbers") -> "Compromise":
        own = self._constraints(numbers)
        kept = self._problem.constraints[: len(self._problem.constraints) - len(own)]
        parts = self._objective(numbers), (*kept, *own)
        problem = eqx.tree_at(lambda one: (one.objective, one.constraints), self._problem, parts)
        return Compromise(problem, self.names, numbers)

    def _objective(self, numbers: "_Numbers") -> Expression:
        return value(LEVEL) + self._sum(numbers.share * numbers.scales)

    def _constraints(self, numbers: "_Numbers") -> tuple[Constraint, ...]:
        level, each = value(LEVEL), zip(self.names, self._terms, *numbers[:3], strict=True)
        rows = [
            (pressed(name), float(scale) * wish - float(direction) * level, offset)
            for name, wish, scale, offset, direction in each
        ]
        rows.append((WEIGHTED, self._sum(numbers.weights * numbers.scales) - level, numbers.bound))
        return tuple(_at_most(*row) for row in rows)

    def _sum(self, factors: Sequence[float] | Float[np.ndarray, " wishes"]) -> Expression:
        terms = (float(factor) * wish for factor, wish in zip(factors, self._terms, strict=True))
        return sum(terms, start=as_expression(0.0))


def without_level(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of decisions by name, but for the level."""
    return {name: one for name, one in values.items() if name != LEVEL}


def _at_most(name: str, expression: Expression, bound: float) -> Constraint:
    """A limit whose bound may be infinite: the row then stays in the program, where it bounds nothing."""
    finite = Constraint(expression, upper=0.0, name=name)
    return finite.with_bounds(-np.inf, float(bound))
