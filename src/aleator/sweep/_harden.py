"""`harden`: constraints as penalties whose weight grows until they hold, dissertation section 3.4."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.border import Progress, one_of, positive, refusal, silent, whole
from aleator._core.leaves import Drawn
from aleator.design import Problem, soft
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._printed import table
from aleator.sweep._runner import finished, running
from aleator.transcription import DEFAULT, AbstractTranscribed, AbstractTranscription, bound_size, transcribe


@final
@dataclass(frozen=True)
class Hardened(Drawn):
    """Solutions by ever larger penalties. `print(hardened)` lists them.

    - `solutions`: one for each of the `weights`, those that failed included;
    - `excesses`: by how much each constraint that became a penalty is exceeded there, by name, relative to its
      magnitude: 0 where it holds;
    - `tolerance`: the excess that is accepted; `interrupted`: whether Ctrl-C ended it.
    """

    solutions: tuple[Solution, ...]
    weights: tuple[float, ...]
    excesses: tuple[Mapping[str, float], ...]
    tolerance: float
    interrupted: bool = False

    @property
    def holds(self) -> bool:
        """Whether all constraints hold at the last solution."""
        return self.solutions[-1].ok and max(self.excesses[-1].values()) <= self.tolerance

    @property
    def best(self) -> Solution:
        """The last solved one, which exceeds least; the last of all if none is solved."""
        solved = [one for one in self.solutions if one.ok]
        return (solved or self.solutions)[-1]

    def __str__(self) -> str:
        rows = [("weight", "objective", "largest excess, relative to its limit's magnitude")]
        for weight, one, excesses in zip(self.weights, self.solutions, self.excesses, strict=True):
            name, worst = max(excesses.items(), key=lambda each: np.nan_to_num(each[1], nan=np.inf))
            excess = f"{worst:.1e} of {name}{'' if one.ok else f'  {one.why()}'}"
            rows.append((f"{weight:.4g}", f"{one.objective:.8g}", excess))
        said = f"hold, to {self.tolerance:.0e} of their magnitudes"
        end = f"all {said}" if self.holds else f"not all {said}: allow larger weights, or see al.conflict"
        return table(rows, end, interrupted=self.interrupted)


def harden(
    problem: Problem,
    *names: str,
    weight: float = 1.0,
    factor: float = 10.0,
    most: int = 10,
    tolerance: float = 1e-4,
    exact: bool = False,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    progress: Progress = silent,
) -> Hardened:
    """Solve a problem with constraints as penalties (`al.soft`), each time with a larger weight, until they hold.

    Each solve starts from the answer of the one before (penalty continuation, Fiacco and McCormick 1968), so that hard
    constraints are approached from designs that break them: where a solver finds no way into them, or to see what each
    costs. Penalties that are not `exact` never hold exactly: the excess falls in inverse proportion to the weight.

    - `problem`, `names`, `exact`: see `al.soft`; `weight`: the first one; `factor`: of each to the one before, above 1;
    - `most`: solves at most; `tolerance`: the excess that is accepted, relative to each constraint's magnitude;
    - `solver`, `transcription`: see `al.solve`.

    Everything is compiled once. Ctrl-C returns the solutions found so far. Raises `ProblemError` as `al.soft` does, and
    for a factor of at most 1.
    """
    one_of("harden: problem", problem, Problem)
    weight, tolerance = positive("harden: weight", weight), positive("harden: tolerance", tolerance)
    if positive("harden: factor", factor) <= 1:
        raise refusal("harden: factor", "a number above 1, by which weights grow", factor)
    chosen, most = tuple(dict.fromkeys(names)) or problem.names, whole("harden: most", most)
    found: list[tuple[Solution, float, Mapping[str, float]]] = []
    with running("harden", lambda: found, progress) as run:
        for done in range(most):
            softened = soft(problem, *names, weight=weight, exact=exact)
            start = found[-1][0].decisions if found else None
            with run.step("weights", done, most, f"weight {weight:.4g}"):
                solution = finished(solve(softened, solver, transcription=transcription, start=start, throw=False))
            excesses = _excesses(transcribe(problem, DEFAULT), chosen, solution)
            found.append((solution, weight, excesses))
            if solution.ok and max(excesses.values()) <= tolerance:
                break
            weight *= factor
    solutions, weights, excesses = zip(*found, strict=True)
    return Hardened(solutions, weights, excesses, tolerance, run.interrupted)


def _excesses(hard: AbstractTranscribed, names: tuple[str, ...], found: Solution) -> dict[str, float]:
    """The excess of each named constraint of the hard problem at a solution's decisions."""
    places = hard.places
    initial = places.vector("initial")
    own = {name: found.decisions[name] for name in places.named(initial)}
    values = hard.at(places.moved(initial, own)).constraints
    excesses = dict.fromkeys(names, 0.0)
    for one, size, rows in zip(hard.problem.constraints, hard.scales, values, strict=True):
        if one.name in excesses:
            beyond = float(np.max(np.maximum(float(one.lower) - rows, rows - float(one.upper))))
            excesses[one.name] = max(excesses[one.name], beyond / (bound_size(one) or size))
    return excesses
