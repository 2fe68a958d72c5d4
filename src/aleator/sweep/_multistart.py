"""`multistart`: one problem solved from several starts, with its local optima in order."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, check_progress, one_of, positive, silent, whole
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.executors import check_executor
from aleator._core.leaves import Drawn
from aleator.design import Problem
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.sweep._each import each, until_interrupted
from aleator.transcription import DEFAULT, AbstractTranscription

# Objectives, or decisions, with a smaller relative difference belong to one local optimum.
_SAME = 1e-4


@final
@dataclass(frozen=True)
class Starts(Drawn):
    """A problem solved from several starts. `print(starts)` lists its local optima.

    - `solutions`: one per start, in order, failed ones included;
    - `interrupted`: whether it was stopped early; the solutions finished by then are included.
    """

    solutions: tuple[Solution, ...]
    interrupted: bool = False

    @property
    def best(self) -> Solution:
        """The best solved one; if none is solved, the least violated."""
        solved = [one for one in self.solutions if one.ok]
        if solved:
            return min(solved, key=lambda one: one.objective)
        return min(self.solutions, key=lambda one: np.nan_to_num(one.certificate.violation, nan=np.inf))

    @property
    def optima(self) -> tuple[tuple[Solution, int], ...]:
        """The local optima, best first, each with the number of starts that led to it.

        Solutions with the same objective count as one, mirrored plans included, and so do those with the same
        decisions, since the objective may be zero.
        """
        solved = sorted((one for one in self.solutions if one.ok), key=lambda one: one.objective)
        starts = [one.problem.placements.vector("initial") for one in solved]
        size = np.max(np.abs([*starts, *(one.vector for one in solved)]), axis=0, initial=1e-12)
        optima: list[tuple[Solution, int]] = []
        for one in solved:
            best, count = optima[-1] if optima else (one, 0)
            close = abs(one.objective - best.objective) <= _SAME * max(abs(one.objective), 1e-12)
            if count and (close or np.all(np.abs(one.vector - best.vector) < _SAME * size)):
                optima[-1] = (best, count + 1)
            else:
                optima.append((one, 1))
        return tuple(optima)

    def __str__(self) -> str:
        rows = [f"{one.objective:14.8g}  from {count} of {len(self.solutions)} starts" for one, count in self.optima]
        failed = sum(not one.ok for one in self.solutions)
        return "\n".join(
            ["local optima (equal objectives count as one)", *rows, *([f"{failed} starts failed"] if failed else [])]
        )


def multistart(
    problem: Problem,
    starts: int | Sequence[Mapping[str, Any]] = 10,
    *,
    spread: float = 0.3,
    seed: int = 0,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Starts:
    """Solve a problem from several starts, given by decisions' names, or from a number of random ones.

    The first random start is the problem's own; the others, drawn from `seed`, differ from it by up to `spread` of each
    decision's range (of its magnitude where a bound is infinite). The problem is compiled once. A start that fails is
    kept with its status; Ctrl-C ends the search and returns the finished solutions. `solver` and `transcription` are
    those of `al.solve`; an `executor` (see `al.pareto`) solves from several starts at once.

    Raises `ProblemError`, before anything is solved, if there is no start, for unknown decisions, and for values that
    are not finite or of the wrong shape.
    """
    one_of("multistart: problem", problem, Problem)
    check_progress("multistart", progress)
    spread, seed = positive("multistart: spread", spread), whole("multistart: seed", seed, least=0)
    if isinstance(starts, bool | Mapping | str) or not isinstance(starts, int | np.integer | Sequence):
        raise ProblemError(
            f"multistart: expected a number of starts, or a list of starts by name; received {starts!r}."
        )
    if not isinstance(starts, Sequence):
        starts = _random(problem, whole("multistart: the number of starts", starts), spread, seed)
    given = list(starts)
    if not given:
        raise ProblemError("multistart: expected at least one start; received none.")
    places = problem.placements
    for start in given:
        places.moved(places.vector("initial"), start)
    check_executor("multistart", executor)
    own = {"problem": problem, "solver": solver, "transcription": transcription}
    calls = [{**own, "start": start} for start in given]
    where = [f"multistart, from start {i + 1}" for i in range(len(calls))]
    solutions: dict[int, Solution] = {}
    progress("starts", 0, len(given))
    with until_interrupted(lambda: solutions) as steps:
        for i, result in each("solve", calls, where, executor):
            if isinstance(result, AleatorError):
                raise result
            solutions[i] = result
            progress("starts", len(solutions), len(given))
            steps.heed(result.status)
    return Starts(tuple(solutions[i] for i in sorted(solutions)), steps.interrupted)


def _random(problem: Problem, count: int, spread: float, seed: int) -> list[dict[str, Any]]:
    places = problem.placements
    first, lower, upper = (places.vector(name) for name in ("initial", "lower", "upper"))
    finite = np.isfinite(upper - lower)
    reach = spread * np.where(finite, np.where(finite, upper - lower, 0.0), np.maximum(np.abs(first), 1.0))
    generator = np.random.default_rng(seed)

    def drawn(i: int) -> Float[np.ndarray, " n"]:
        shift = generator.uniform(-1.0, 1.0, first.size) if i else np.zeros(first.size)
        return np.clip(first + reach * shift, lower, upper)

    return [places.named(drawn(i)) for i in range(count)]
