"""One problem for every compromise between several wishes: its numbers choose which."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator.design import Constraint, Expression, Problem, as_expression, declared_anew, pure, value
from aleator.solution import Solution
from aleator.sweep._trade_off import across
from aleator.transcription import AbstractTranscribed, AbstractTranscription, transcribe
from aleator.uncertainty import Decision

# The decision to which wishes are pressed down together, and the beginning of the names of the constraints that do.
LEVEL, _PRESSED = "trade-off.level", "trade-off: wish "
# The share of all wishes in the objective, so that no wish is left worse than it need be.
_SHARE = 1e-4


class Design(NamedTuple):
    """A design that was found.

    - `solution`: of the compromise that led there; `values`: the wishes, in their own units;
    - `weights`: how much they count there, NaN where that is not known; `factors`: a sum of the wishes with these is
      stationary there.
    """

    solution: Solution
    values: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, " wishes"]
    factors: Float[np.ndarray, " wishes"]


class Compromise(NamedTuple):
    """A problem that leads to one point of a front, and the numbers `s`, `a`, `r`, `δ` of `Wishes` in it."""

    problem: Problem
    scales: Float[np.ndarray, " wishes"]
    offsets: Float[np.ndarray, " wishes"]
    direction: float
    shares: Float[np.ndarray, " wishes"]

    def away(self, values: Float[np.ndarray, " wishes"]) -> Float[np.ndarray, " wishes"]:
        """By how much a design's wishes, scaled, are off the line on which this one is to be."""
        return across(values * self.scales - self.offsets)

    def level(self, values: Float[np.ndarray, " wishes"]) -> float:
        """The least level `t` above some values of the wishes."""
        return float(np.max(values * self.scales - self.offsets))


@final
class Wishes:
    """A problem whose objective is replaced by a level `t` above several wishes `f`, in scales `s` of these:

        minimise r t + Σ δ_k s_k f_k   subject to   s_k f_k - r t <= a_k for each k.

    The numbers choose one point of the front. Where `r` is one, it lies on a line through `a` on which all wishes get
    better alike (Pascoletti and Serafini 1984), and small `δ` rule out points at which a wish could be better at no
    cost (Mavrotas 2009). Where it is zero, a sum of wishes is least while others are held. All are data, so that one
    program serves the whole front.
    """

    def __init__(self, problem: Problem, wishes: Mapping[str, Expression]):
        self.names = tuple(wishes)
        self._original = problem
        self.expressions = tuple(as_expression(one) for one in wishes.values())
        # Scales and weights carry units.
        self._terms = tuple(map(pure, self.expressions))
        ones = np.ones(len(wishes))
        self._summed = declared_anew(problem, problem.simulation, minimize=self._sum(ones))
        objective, limits = self._parts(ones, ones, 1.0, ones)
        self._problem = declared_anew(
            problem, problem.simulation, minimize=objective, subject_to=limits, decisions={LEVEL: Decision(1.0)}
        )

    def compromise(
        self,
        scales: Float[np.ndarray, " wishes"],
        offsets: Float[np.ndarray, " wishes"] | float,
        *,
        direction: float = 1.0,
        shares: Float[np.ndarray, " wishes"] | float = _SHARE,
    ) -> Compromise:
        """The problem with some numbers `s`, `a`, `r` and `δ`."""
        none = np.zeros(len(scales))
        numbers = scales, none + offsets, direction, none + shares
        parts = self._parts(*numbers)
        return Compromise(eqx.tree_at(lambda one: (one.objective, one.constraints), self._problem, parts), *numbers)

    def only(self, which: int) -> Problem:
        """The problem with one wish as its objective, without any others."""
        return declared_anew(self._original, self._original.simulation, minimize=self.expressions[which])

    def transcribed(self, transcription: AbstractTranscription) -> AbstractTranscribed:
        """The program of a compromise, whose rows are the wishes, at the problem's start."""
        return transcribe(self.compromise(np.ones(len(self.names)), np.inf, direction=0.0).problem, transcription)

    def rows(self, transcribed: AbstractTranscribed) -> Int[np.ndarray, " wishes"]:
        """The rows of a compromise's program that press the wishes down."""
        return np.array([rows.start for rows in transcribed.rows[len(self._original.constraints) :]])

    def design(self, compromise: Compromise, solution: Solution) -> Design:
        """A compromise's solution, with the wishes there and how much each counts, in their own units."""
        pressed = solution.constraints[len(self._original.constraints) :]
        scaled = np.array([float(np.ravel(one.values)[0]) for one in pressed])
        scaled = scaled + compromise.direction * solution.decisions[LEVEL]
        prices = np.array([solution.multiplier(one.name) for one in pressed])
        weights = compromise.scales * (prices + compromise.shares)
        return Design(solution, scaled / compromise.scales, weights, weights)

    def solution_of(self, design: Design) -> Solution:
        """A design as the solution of the original problem, with the sum of the wishes as its objective.

        Whatever led there is a stationary point of that sum: what was added to choose a place is left out.
        """
        solution, own = design.solution, len(self._original.constraints)
        rows = sum(one.multipliers.size for one in solution.constraints[:own])
        # States that are variables bring rows of their own.
        is_all = rows + len(self.names) == solution.multipliers.size
        return replace(
            solution,
            problem=eqx.tree_at(lambda one: one.objective, self._summed, self._sum(design.factors)),
            objective=float(design.factors @ design.values),
            decisions=without_level(solution.decisions),
            vector=solution.vector[[name != LEVEL for name in solution.problem.placements.entry_names()]],
            constraints=solution.constraints[:own],
            at_bounds=tuple(name for name in solution.at_bounds if name != LEVEL),
            idle=tuple(name for name in solution.idle if name != LEVEL),
            multipliers=solution.multipliers[:rows] if is_all else np.zeros(0),
            bound_multipliers=without_level(solution.bound_multipliers),
        )

    def _parts(
        self,
        scales: Float[np.ndarray, " wishes"],
        offsets: Float[np.ndarray, " wishes"],
        direction: float,
        shares: Float[np.ndarray, " wishes"],
    ) -> tuple[Expression, tuple[Constraint, ...]]:
        """The objective, and all limits. A row whose bound is infinite stays, and bounds nothing."""
        level = direction * value(LEVEL)
        pressed = tuple(
            Constraint(float(scale) * wish - level, upper=0.0, name=_PRESSED + name).with_bounds(-np.inf, float(most))
            for name, wish, scale, most in zip(self.names, self._terms, scales, offsets, strict=True)
        )
        return level + self._sum(shares * scales), (*self._original.constraints, *pressed)

    def _sum(self, factors: Float[np.ndarray, " wishes"]) -> Expression:
        terms = (float(factor) * wish for factor, wish in zip(factors, self._terms, strict=True))
        return sum(terms, start=as_expression(0.0))


def without_level(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of decisions by name, but for the level."""
    return {name: one for name, one in values.items() if name != LEVEL}
