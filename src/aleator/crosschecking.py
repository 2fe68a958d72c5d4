"""`cross_check`: a problem solved by two transcriptions that share no discretisation, and how far they agree."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.given import one_of, positive
from aleator.design import Problem
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.solving import solve
from aleator.transcription import DEFAULT, AbstractTranscription, Simultaneous
from aleator.uncertainty import Decision

# What is smaller than this part of the largest of its kind is compared with that.
_SMALL = 1e-3


@final
@dataclass(frozen=True)
class CrossChecked:
    """Two solutions of one problem, and the differences between them.

    - `first`, `second`: the solutions; `ways`: how they were found, in words;
    - `objective`, `decisions`, `statistics`, `multipliers`: relative differences; of the last three by name or text,
      the largest of each array. Those of decisions are relative to the range between their bounds where that is finite;
    - `tolerance`: the difference that is accepted.
    """

    first: Solution
    second: Solution
    ways: tuple[str, str]
    objective: float
    decisions: Mapping[str, float]
    statistics: Mapping[str, float]
    multipliers: Mapping[str, float]
    tolerance: float

    @property
    def agree(self) -> bool:
        """Whether both are solved, and objective and statistics differ by no more than is accepted.

        Decisions and multipliers may differ without that where an optimum is flat.
        """
        differences = [self.objective, *self.statistics.values()]
        return self.first.ok and self.second.ok and all(one <= self.tolerance for one in differences)

    def __str__(self) -> str:
        head = "agree" if self.agree else "do NOT agree"
        rows = [f"{self.ways[0]} and {self.ways[1]} {head} to {self.tolerance:.1g}"]
        for way, one in zip(self.ways, (self.first, self.second), strict=True):
            rows.append(f"  {way:<28} objective {one.objective:.9g}, {one.status.value}")
        kinds = {"decisions": self.decisions, "statistics": self.statistics, "multipliers": self.multipliers}
        rows.append(f"  {'objective':<28} differs by {self.objective:.1e}")
        for kind, differences in kinds.items():
            if differences:
                name, worst = max(differences.items(), key=lambda one: one[1])
                rows.append(f"  {kind:<28} differ by {worst:.1e} at most ({name})")
        if not self.agree:
            rows.append("  Refine both grids (refine=True, al.Simultaneous(error=...)), or start both elsewhere.")
        return "\n".join(rows)


def cross_check(
    problem: Problem,
    *,
    first: AbstractTranscription = DEFAULT,
    second: AbstractTranscription | None = None,
    solvers: tuple[AbstractSolver | None, AbstractSolver | None] = (None, None),
    tolerance: float = 1e-4,
    refine: bool = False,
) -> CrossChecked:
    """Solve a problem by two transcriptions and compare objective, decisions, statistics and multipliers.

    - `first`, `second`: by default shooting, and direct collocation by Hermite and Simpson's scheme;
    - `solvers`: of each; those that suit them by default;
    - `tolerance`: the relative difference of objective and statistics that is accepted;
    - `refine`: whether the grid of each is refined until its own error is tolerated.

    Solutions that failed are compared as they are, and do not agree. Raises `ProblemError` for what is no problem or no
    transcription.
    """
    one_of("cross_check: problem", problem, Problem)
    second = Simultaneous() if second is None else second
    for name, way in (("first", first), ("second", second)):
        one_of(f"cross_check: {name}", way, AbstractTranscription, "al.Simultaneous()")
    tolerance = positive("cross_check: tolerance", tolerance)
    ways = first, second
    one, other = (
        solve(problem, solver, transcription=way, refine=refine, throw=False)
        for way, solver in zip(ways, solvers, strict=True)
    )
    return CrossChecked(
        first=one,
        second=other,
        ways=(type(first).__name__, type(second).__name__),
        objective=_difference(one.objective, other.objective, 0.0),
        decisions=_decisions(problem, one, other),
        statistics=_differences(one.statistics, other.statistics),
        multipliers=_differences(_shadow_prices(one), _shadow_prices(other)),
        tolerance=tolerance,
    )


def _decisions(problem: Problem, one: Solution, other: Solution) -> dict[str, float]:
    """By name; infinite for a control that has followed a finer mesh in one of them."""
    return {name: _decided(place, one.decisions[name], other.decisions[name]) for name, place in _places(problem)}


def _places(problem: Problem) -> list[tuple[str, Decision]]:
    return [(name, place.decision) for name, place in problem.placements.decisions.items()]


def _decided(decision: Decision, first: object, second: object) -> float:
    one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if one.shape != other.shape:
        return float("inf")
    between = np.asarray(decision.upper, dtype=float) - np.asarray(decision.lower, dtype=float)
    size = np.where(np.isfinite(between), between, np.maximum(np.abs(one), np.abs(other)))
    return float(np.max(np.abs(one - other) / np.where(size > 0, size, 1.0), initial=0.0))


def _shadow_prices(solution: Solution) -> dict[str, float]:
    """The shadow price of each constraint, by its text: those of single instants depend on the grid."""
    return {one.text: one.shadow_price for one in solution.constraints}


def _differences(first: Mapping[str, object], second: Mapping[str, object]) -> dict[str, float]:
    largest = max((float(np.max(np.abs(np.asarray(one)))) for one in first.values()), default=0.0)
    return {text: _difference(one, second[text], _SMALL * largest) for text, one in first.items()}


def _difference(first: object, second: object, least: float) -> float:
    """The largest difference of two arrays, relative to the largest of their entries; infinite if shapes differ."""
    one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if one.shape != other.shape:
        return float("inf")
    size = max(float(np.max(np.abs(one))), float(np.max(np.abs(other))), least)
    away = float(np.max(np.abs(one - other)))
    return away / size if size > 0 else 0.0
