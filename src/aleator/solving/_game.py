"""The game of a designer against an opponent, who chooses the intervals of a problem: limits in some scenarios as one
program, the search for worse scenarios, and the meaning of an answer in each.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator.certification import worth_imposing
from aleator.design import Problem, with_simulation
from aleator.ensemble import corners_of, spread_over
from aleator.nlp import Evaluation, NonlinearProgram, Outcome
from aleator.solution import Solution
from aleator.transcription import AbstractTranscribed, Remembered
from aleator.uncertainty import at_values, intervals_of

LEVEL = "objective.worst"
"""The decision that is the objective's level, and the limit that holds it there."""

MOST_CORNERS = 128
"""The most corners of the intervals that are tried at the start."""

# Values closer than this part of the box are the same.
_SAME = 1e-3
# Corners, and random points inside, at which a design is shown besides its scenarios.
_SHOWN_CORNERS, _SHOWN_INSIDE = 16, 2


class Scenario(NamedTuple):
    """Values of the intervals, and which limits are imposed there; the last limit is that of the objective."""

    numbers: Float[np.ndarray, " intervals"]
    imposed: Bool[np.ndarray, " limits"]


@final
@dataclass(frozen=True)
class Game:
    """A problem whose intervals an opponent chooses.

    - `problem`: as it was declared; `transcribed`: with a level of the objective, and intervals as free decisions;
    - `where`: the intervals among its variables, by name; `low`, `high`: their ends.
    """

    problem: Problem
    transcribed: AbstractTranscribed
    where: dict[str, int]
    low: Float[np.ndarray, " intervals"]
    high: Float[np.ndarray, " intervals"]

    @classmethod
    def of(cls, problem: Problem, transcribed: AbstractTranscribed) -> "Game":
        """That of a problem and its program."""
        decisions = transcribed.places.decisions
        where = {name: decisions[name].where.start for name in intervals_of(problem.placements)}
        low, high = (transcribed.places.vector(end)[[*where.values()]] for end in ("lower", "upper"))
        return cls(problem, transcribed, where, low, high)

    def numbers(self, points: Float[np.ndarray, "*some intervals"]) -> Float[np.ndarray, "*some intervals"]:
        """Points of the unit box as values of the intervals."""
        return self.low + points * (self.high - self.low)

    def named(self, numbers: Float[np.ndarray, " intervals"]) -> dict[str, float]:
        """Values of the intervals by name."""
        return dict(zip(self.where, numbers.tolist(), strict=True))

    @property
    def level(self) -> int:
        """The place of the objective's level among the variables."""
        return self.transcribed.places.decisions[LEVEL].where.start

    def at(self, point: Float[np.ndarray, " n"], numbers: Float[np.ndarray, "*some intervals"]) -> np.ndarray:
        """The variables with other values of the intervals."""
        moved = np.broadcast_to(point, (*numbers.shape[:-1], len(point))).copy()
        moved[..., [*self.where.values()]] = numbers
        return moved

    def rows(self, scenario: Scenario) -> Int[np.ndarray, " rows"]:
        """The rows of the limits that are imposed in a scenario."""
        parts = zip(self.transcribed.rows, scenario.imposed, strict=True)
        return np.flatnonzero(np.concatenate([np.full(rows.stop - rows.start, own) for rows, own in parts]))

    def program(self, single: NonlinearProgram, scenarios: Sequence[Scenario]) -> NonlinearProgram:
        """The limits of some scenarios in one program, in which the intervals are no variables: they are fixed.

        `single`: the program of one scenario.
        """
        rows, where = list(map(self.rows, scenarios)), [*self.where.values()]

        def together(of: Any) -> np.ndarray:
            return np.concatenate([of[one] for one in rows])

        @Remembered
        def each(point: Float[np.ndarray, " n"]) -> list[Evaluation]:
            return [single.evaluate(self.at(point, one.numbers)) for one in scenarios]

        def evaluate(point: Float[np.ndarray, " n"]) -> Evaluation:
            parts = list(zip(each(point), rows, strict=True))
            jacobian = np.concatenate([one.jacobian[some] for one, some in parts])
            jacobian[:, where] = 0.0
            constraints = np.concatenate([one.constraints[some] for one, some in parts])
            return Evaluation(parts[0][0].objective, parts[0][0].gradient, constraints, jacobian)

        def sizes(point: Float[np.ndarray, " n"], evaluation: Evaluation) -> Float[np.ndarray, " rows"]:
            del evaluation  # of all scenarios
            assert single.sizes is not None
            parts = zip(scenarios, each(point), rows, strict=True)
            return np.concatenate([single.sizes(self.at(point, one.numbers), own)[some] for one, own, some in parts])

        lower, upper = single.lower.copy(), single.upper.copy()
        lower[where] = upper[where] = single.start[where]
        return replace(
            single,
            evaluate=evaluate,
            lower=lower,
            upper=upper,
            constraint_lower=together(single.constraint_lower),
            constraint_upper=together(single.constraint_upper),
            constraint_scale=together(single.constraint_scale),
            sparsity=None if single.sparsity is None else together(single.sparsity),
            hessian=None,
            sizes=sizes,
            values=None,
        )

    def beyond(
        self, single: NonlinearProgram, point: Float[np.ndarray, " n"], points: Float[np.ndarray, "points intervals"]
    ) -> Float[np.ndarray, "points limits"]:
        """The excess over each limit at points of the unit box; NaN where there is no value."""
        assert single.values is not None
        _, values = single.values(self.at(point, self.numbers(points)))
        excess = single.limits.excess(values)
        return np.stack([excess[:, rows].max(axis=1) for rows in self.transcribed.rows], axis=1)

    def first(self, point: Float[np.ndarray, " n"]) -> list[Scenario]:
        """Scenarios to begin with: for each limit the corner at which it is worst."""
        corners = corners_of(len(self.low), MOST_CORNERS, np.random.default_rng(0))
        beyond = np.nan_to_num(self.beyond(self.transcribed.program, point, corners), nan=-np.inf)
        worst = np.argmax(beyond, axis=0)
        return [Scenario(self.numbers(corners[k]), worst == k) for k in np.unique(worst)]

    def worse(
        self, single: NonlinearProgram, outcome: Outcome, scenarios: Sequence[Scenario], seed: int
    ) -> tuple[list[Scenario], int]:
        """Scenarios that break a limit by more than the present ones do, and how many values were tried."""
        held, count = [(one.numbers - self.low) / (self.high - self.low) for one in scenarios], 0
        candidates = np.concatenate([np.stack(held), spread_over(len(self.low), seed)])

        def excess_at(points: Float[np.ndarray, "points intervals"]) -> Float[np.ndarray, "points limits"]:
            nonlocal count
            count += len(points)
            return self.beyond(single, outcome.point, points)

        imposed = np.stack([one.imposed for one in scenarios])
        sizes, ends = np.zeros(imposed.shape[1]), np.cumsum([0, *(len(self.rows(one)) for one in scenarios)])
        for scenario, first, last in zip(scenarios, *(ends[:-1], ends[1:]), strict=True):
            own = np.zeros(len(single.constraint_lower))
            own[self.rows(scenario)] = outcome.sizes[first:last]
            sizes = np.maximum(sizes, [own[rows].max(initial=0.0) for rows in self.transcribed.rows])
        new, _ = worth_imposing(excess_at, candidates, imposed, sizes, seed)
        limits = np.arange(len(new))
        return [
            Scenario(self.numbers(one), limits == i)
            for i, some in enumerate(new)
            for k, one in enumerate(some)
            if all(np.max(np.abs(one - other)) > _SAME for other in some[:k])
        ], count

    def within(self, scenarios: Sequence[Scenario], outcome: Outcome) -> Iterator[Outcome]:
        """The outcome in each scenario alone, with its share of the multipliers; of none, where it was added later."""
        single, last = self.transcribed.program, 0
        assert single.sizes is not None
        for one in scenarios:
            point, rows = self.at(outcome.point, one.numbers), self.rows(one)
            own, last = single.evaluate(point), last + len(rows)
            multipliers, active = np.zeros(len(own.constraints)), np.zeros(len(own.constraints), dtype=bool)
            if last <= len(outcome.multipliers):
                some = slice(last - len(rows), last)
                multipliers[rows], active[rows] = outcome.multipliers[some], outcome.active[some]
            parts = {"multipliers": multipliers, "active": active, "sizes": single.sizes(point, own)}
            yield replace(outcome, point=point, evaluation=own, **parts)

    def within_problem(self, solution: Solution, numbers: Float[np.ndarray, " intervals"]) -> Solution:
        """The solution in a scenario as that of the problem in which the intervals have these values."""
        others = {*self.where, LEVEL}

        def without(named: Mapping[str, Any]) -> dict[str, Any]:
            return {name: one for name, one in named.items() if name not in others}

        return replace(
            solution,
            problem=with_simulation(self.problem, at_values(self.problem.simulation, self.named(numbers))),
            objective=solution.decisions[LEVEL] + float(solution.constraints[-1].excess.max()),
            decisions=without(solution.decisions),
            vector=np.delete(solution.vector, self.level),
            constraints=solution.constraints[:-1],
            at_bounds=tuple(name for name in solution.at_bounds if name not in others),
            idle=tuple(name for name in solution.idle if name not in others),
            multipliers=solution.multipliers[: self.transcribed.rows[-1].start],
            bound_multipliers=without(solution.bound_multipliers),
        )

    def others(self, scenarios: Sequence[Scenario]) -> list[Scenario]:
        """Corners and points inside that are no scenarios, with nothing imposed."""
        generator, count = np.random.default_rng(0), len(self.low)
        corners = corners_of(count, _SHOWN_CORNERS, generator)
        points = self.numbers(np.concatenate([corners, generator.random((_SHOWN_INSIDE, count))]))
        known = {one.numbers.tobytes() for one in scenarios}
        none = np.zeros(len(self.transcribed.rows), dtype=bool)
        return [Scenario(one, none) for one in points if one.tobytes() not in known]
