"""`cross_check`: a problem solved by two transcriptions that share no discretisation, and how far they agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.border import Progress, one_of, positive, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator._core.leaves import Drawn
from aleator.design import Estimated, Problem, estimated, statistics_in
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.sweep._runner import SOLVE, running
from aleator.transcription import DEFAULT, AbstractTranscription, Simultaneous

# What is smaller than this part of the largest of its kind is compared with that.
_SMALL = 1e-3


@final
@dataclass(frozen=True)
class CrossChecked(Drawn):
    """Two solutions of one problem, and the differences between them.

    - `first`, `second`: the solutions; `ways`: how they were found, in words;
    - `objective`, `decisions`, `statistics`, `multipliers`: relative differences; of the last three by name or text,
      the largest of each array. That of the objective is relative to its value, or to its change by relative errors of
      the statistics and numbers in it where these change it by more (a difference, or a squared distance, that becomes
      zero). Those of decisions are relative to the range between their bounds where that is finite. Paths are compared
      at the instants that both grids have;
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
        both = list(zip(self.ways, (self.first, self.second), strict=True))
        unsolved = [f"  {way}: {one.why()}" for way, one in both if not one.ok]
        head = "agree" if self.agree else "are not both solved, nor agree" if unsolved else "do NOT agree"
        rows = [f"{self.ways[0]} and {self.ways[1]} {head} to {self.tolerance:.1g}"]
        rows += [f"  {way:<32} objective {one.objective:.9g}" for way, one in both]
        rows.append(f"  {'objective':<32} differs by {self.objective:.1e}")
        kinds = {"decisions": self.decisions, "statistics": self.statistics, "multipliers": self.multipliers}
        for kind, differences in kinds.items():
            if differences:
                name, worst = max(differences.items(), key=lambda one: one[1])
                rows.append(f"  {kind:<32} differ by {worst:.1e} at most ({name})")
        others = [name for name, one in self.decisions.items() if self.tolerance < one < np.inf]
        remedy = "Refine both grids (refine=True, al.Simultaneous(error=...)), or start both elsewhere."
        if self.objective <= self.tolerance and others:
            remedy = (
                f"Both reach the same objective, by other values of {', '.join(others[:3])}: there are several optima, "
                "or a flat one. Let the objective tell them apart."
            )
        return "\n".join([*rows, *([] if self.agree else unsolved or [f"  {remedy}"])])


def cross_check(
    problem: Problem,
    *,
    first: AbstractTranscription = DEFAULT,
    second: AbstractTranscription | None = None,
    solvers: tuple[AbstractSolver | None, AbstractSolver | None] = (None, None),
    tolerance: float = 1e-4,
    refine: bool | None = None,
    most_states: int = 20_000,
    progress: Progress = silent,
) -> CrossChecked:
    """Solve a problem by two transcriptions and compare objective, decisions, statistics and multipliers.

    - `first`, `second`: by default shooting, and direct collocation by Hermite and Simpson's scheme;
    - `solvers`: of each; those that suit them by default;
    - `tolerance`: the relative difference of objective and statistics that is accepted;
    - `refine`: whether the grid of each is refined until its own error is tolerated, see `solve`;
    - `most_states`: the budget of direct collocation, whose program has the states of all realisations at all points of
      its first mesh as variables: 1000 of them take some seconds, 5000 half a minute, 100 000 hours and gigabytes.

    Solutions that failed are compared as they are, and do not agree. Ctrl-C ends it without a result. Raises
    `ProblemError` for a program of more than `most_states` before anything is solved.
    """
    one_of("cross_check: problem", problem, Problem)
    second = Simultaneous() if second is None else second
    ways, tolerance = (first, second), positive("cross_check: tolerance", tolerance)
    most_states = whole("cross_check: most_states", most_states)
    if not isinstance(solvers, Sequence) or [isinstance(one, AbstractSolver | None) for one in solvers] != [True, True]:
        raise refusal("cross_check: solvers", "two, such as (None, al.solvers.Ipopt())", solvers)
    for name, way in zip(("first", "second"), ways, strict=True):
        one_of(f"cross_check: {name}", way, AbstractTranscription, "al.Simultaneous()")
        if isinstance(way, Simultaneous) and (count := way.count(problem)) > most_states:
            raise ProblemError(
                f"cross_check: by {way.name}, {count} states would be variables, more than the {most_states} of "
                "`most_states`, which would take long: check it on a coarser grid, such as problem.on_grid(al.Grid("
                "..., 50)), with an expansion of lower order, or allow more."
            )
    own = {"problem": problem, "refine": refine}
    calls = [{**own, "solver": by, "transcription": way} for way, by in zip(ways, solvers, strict=True)]
    with running("cross_check", lambda: False, progress) as run:
        (_, one), (_, other) = run.each(SOLVE, "cross-check", calls, [way.name for way in ways])
    names = [way.name for way in ways]
    if first.name == second.name:
        names = [f"{first.name} by {found.effort.solver}" for found in (one, other)]
    size = max(_objective_size(one), _objective_size(other))
    ranges = {
        name: np.asarray(place.decision.upper, float) - np.asarray(place.decision.lower, float)
        for name, place in problem.placements.decisions.items()
    }
    return CrossChecked(
        first=one,
        second=other,
        ways=(names[0], names[1]),
        objective=_difference(one.objective, other.objective, size),
        decisions={name: _difference(one.decisions[name], other.decisions[name], 0.0, ranges[name]) for name in ranges},
        statistics=_statistics(one, other),
        multipliers=_multipliers(one, other, size),
        tolerance=tolerance,
    )


def _objective_size(solution: Solution) -> float:
    """How much the objective would change, per relative error of all statistics and numbers in it."""
    known = {text: Estimated(value, _SMALL * np.abs(value)) for text, value in solution.statistics.items()}
    found = estimated(solution.problem, solution.problem.objective, known, solution.vector, doubt=_SMALL)
    return float(np.nan_to_num(0.0 if found is None else found.error / _SMALL, posinf=0.0))


def _statistics(one: Solution, other: Solution) -> dict[str, float]:
    """By text; those of paths at the instants that both grids have, as parts of their duration to nine digits."""
    mine, theirs = dict(one.statistics), dict(other.statistics)
    for statistic in (each for each in statistics_in(one.problem.expressions) if each.is_path):
        text, place = statistic.text(), statistic.functionals[0].place
        grids = (solution.problem.grid.of(place) for solution in (one, other))
        _, *at = np.intersect1d(*(np.round(grid.fractions, 9) for grid in grids), return_indices=True)
        mine[text], theirs[text] = (values[text][some] for values, some in zip((mine, theirs), at, strict=True))
    least = _SMALL * max((float(np.max(np.abs(value))) for value in mine.values()), default=0.0)
    return {text: _difference(value, theirs[text], least) for text, value in mine.items()}


def _multipliers(one: Solution, other: Solution, size: float) -> dict[str, float]:
    """Differences of the shadow prices of constraints, by text: those of single instants depend on the grid.

    Prices count as equal if no relative change of a bound would show in the objective by them.
    """
    largest = max((abs(limit.shadow_price) for limit in one.constraints), default=0.0)
    least = max(size, abs(one.objective), abs(other.objective))
    differences = {}
    for limit, their in zip(one.constraints, other.constraints, strict=True):
        floor = _SMALL * max(largest, least / limit.scale if limit.scale else 0.0)
        differences[limit.text] = _difference(limit.shadow_price, their.shadow_price, floor)
    return differences


def _difference(first: object, second: object, least: float, ranges: float | np.ndarray = np.inf) -> float:
    """The largest difference of two arrays, relative to `ranges` where these are finite, else to the largest of their
    entries, or to `least` if that is larger; infinite if shapes differ, as of a control that has followed a finer mesh.
    """
    one, other = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if one.shape != other.shape:
        return float("inf")
    magnitude = max(float(np.max(np.abs([one, other]), initial=0.0)), least)
    size = np.where(np.isfinite(ranges), ranges, magnitude)
    return float(np.max(np.abs(one - other) / np.where(size > 0, size, 1.0), initial=0.0))
