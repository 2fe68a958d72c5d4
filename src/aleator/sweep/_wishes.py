"""One problem for every compromise between several wishes: its numbers choose which."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator.design import Constraint, Expression, Problem, as_expression, declared_anew, pure, value
from aleator.solution import Solution
from aleator.transcription import AbstractTranscribed
from aleator.uncertainty import Decision

# The decision to which all wishes are pressed down together, and the names of the constraints that do.
_OWN = "trade-off: "
LEVEL, _WEIGHTED = "trade-off.level", f"{_OWN}weighted sum"
# The share of all wishes in the objective, so that no wish is left worse than it need be.
_SHARE = 1e-4


def pressed(name: str) -> str:
    """The name of the constraint that presses one wish down."""
    return f"{_OWN}wish {name}"


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


class Compromise(NamedTuple):
    """A problem that leads to one point of a front, and the numbers `s`, `a`, `r`, `w`, `b`, `δ` of `Wishes` in it."""

    problem: Problem
    scales: Float[np.ndarray, " wishes"]
    offsets: Float[np.ndarray, " wishes"]
    directions: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, " wishes"]
    bound: float
    share: float

    def away(self, values: Float[np.ndarray, " wishes"]) -> Float[np.ndarray, " wishes"]:
        """By how much a design's wishes differ from where this one is to be, in scaled wishes."""
        away = values * self.scales - self.offsets
        if self.directions.all():
            return away - away.mean()
        return np.where(np.isfinite(away) & (self.directions == 0), away, 0.0)

    def distance(self, values: Float[np.ndarray, " wishes"]) -> float:
        """How far a design's wishes are from where this one is to be, in scaled wishes."""
        return float(np.ptp(np.append(self.away(values), 0.0)))


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
        self._original = problem
        self.expressions = tuple(as_expression(one) for one in wishes.values())
        # Scales and weights carry units.
        self._terms = tuple(map(pure, self.expressions))
        ones = np.ones(len(wishes))
        self._summed = declared_anew(problem, problem.simulation, minimize=self._sum(ones))
        objective, limits = self._parts(ones, ones, ones, ones, 1.0, 1.0)
        level = {LEVEL: Decision(1.0)}
        whole = (*problem.constraints, *limits)
        self._problem = declared_anew(
            problem, problem.simulation, minimize=objective, subject_to=whole, decisions=level
        )

    def rows(self, transcribed: AbstractTranscribed) -> Int[np.ndarray, " wishes"]:
        """The rows of the program of a compromise that press the wishes down."""
        first = len(self._original.constraints)
        return np.array([rows.start for rows in transcribed.rows[first : first + len(self.names)]])

    def solution_of(self, design: Design) -> Solution:
        """A design as the solution of the original problem, with the sum of the wishes as its objective.

        Whatever led there is a stationary point of that sum: what was added to choose a place is left out.
        """
        solution, own = design.solution, len(self._original.constraints)
        rows = sum(one.multipliers.size for one in solution.constraints)
        # States that are variables bring rows of their own.
        is_all = rows == solution.multipliers.size
        return replace(
            solution,
            problem=eqx.tree_at(lambda one: one.objective, self._summed, self._sum(design.factors)),
            objective=float(design.factors @ design.values),
            decisions=without_level(solution.decisions),
            vector=solution.vector[[name != LEVEL for name in solution.problem.placements.entry_names()]],
            constraints=solution.constraints[:own],
            at_bounds=tuple(name for name in solution.at_bounds if name != LEVEL),
            idle=tuple(name for name in solution.idle if name != LEVEL),
            multipliers=solution.multipliers[: rows - len(self.names) - 1] if is_all else np.zeros(0),
            bound_multipliers=without_level(solution.bound_multipliers),
        )

    def only(self, which: int) -> Problem:
        """The problem with one wish as its objective, without any others."""
        return declared_anew(self._original, self._original.simulation, minimize=self.expressions[which])

    def compromise(
        self,
        scales: Float[np.ndarray, " wishes"],
        *,
        offsets: float | Float[np.ndarray, " wishes"] = np.inf,
        directions: float | Float[np.ndarray, " wishes"] = 0.0,
        weights: Float[np.ndarray, " wishes"] | None = None,
        share: float = _SHARE,
    ) -> Compromise:
        """The problem with some numbers `s`, `a`, `r`, `w` and `δ`; without weights, their row bounds nothing."""
        none = np.zeros(len(scales))
        bound, weights = (np.inf, none) if weights is None else (0.0, weights)
        numbers = scales, none + offsets, none + directions, weights, bound, share
        objective, limits = self._parts(*numbers)
        parts = objective, (*self._original.constraints, *limits)
        problem = eqx.tree_at(lambda one: (one.objective, one.constraints), self._problem, parts)
        return Compromise(problem, *numbers)

    def design(self, compromise: Compromise, solution: Solution) -> Design:
        """A compromise's solution, with the wishes there and how much each counts, in their own units."""
        scales, level = compromise.scales, solution.decisions[LEVEL]
        rows = {one.name: float(np.ravel(one.values)[0]) for one in solution.constraints if one.name.startswith(_OWN)}
        scaled = np.array([rows[pressed(name)] for name in self.names]) + compromise.directions * level
        prices = np.array([solution.multiplier(pressed(name)) for name in self.names])
        weights = scales * (prices + solution.multiplier(_WEIGHTED) * compromise.weights + compromise.share)
        return Design(solution, scaled / scales, weights, weights)

    def _parts(
        self,
        scales: Float[np.ndarray, " wishes"],
        offsets: Float[np.ndarray, " wishes"],
        directions: Float[np.ndarray, " wishes"],
        weights: Float[np.ndarray, " wishes"],
        bound: float,
        share: float,
    ) -> tuple[Expression, list[Constraint]]:
        """The objective and the limits on the wishes. A row whose bound is infinite stays, and bounds nothing."""
        level, each = value(LEVEL), zip(self.names, self._terms, scales, offsets, directions, strict=True)
        rows = [
            (pressed(name), float(scale) * wish - float(direction) * level, offset)
            for name, wish, scale, offset, direction in each
        ]
        rows.append((_WEIGHTED, self._sum(weights * scales) - level, bound))
        limits = [Constraint(one, upper=0.0, name=name).with_bounds(-np.inf, float(most)) for name, one, most in rows]
        return level + self._sum(share * scales), limits

    def _sum(self, factors: Sequence[float] | Float[np.ndarray, " wishes"]) -> Expression:
        terms = (float(factor) * wish for factor, wish in zip(factors, self._terms, strict=True))
        return sum(terms, start=as_expression(0.0))


def without_level(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of decisions by name, but for the level."""
    return {name: one for name, one in values.items() if name != LEVEL}
