"""`pareto`: one problem for many values of a bound (the constraint form of multi-objective design, section 3.5.1)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.given import a_name, one_of, real_array
from aleator._core.heard import heeding
from aleator._core.progress import Progress, silent
from aleator.design import Problem, Solution, Times, current, refuse_changed
from aleator.nlp import AbstractSolver, Status
from aleator.solving import solve


@final
@dataclass(frozen=True)
class Front:
    """Optimal designs along a bound. `print(front)` shows them.

    - `bound`: the name of the constraint; `values`: its bounds, shape (points,);
    - `solutions`: one a point, also where the problem is infeasible: see `Solution.status` and `Solution.why()`. Where
      it was refused before it was solved, because no decision can meet the bound, all numbers are not a number;
    - `interrupted`: whether the sweep was stopped early; the points finished by then are all here.
    """

    bound: str
    values: Float[np.ndarray, " points"]
    solutions: tuple[Solution, ...]
    interrupted: bool = False

    @property
    def solved(self) -> np.ndarray:
        """Which points have a certified optimum."""
        return np.array([solution.ok for solution in self.solutions], dtype=bool)

    @property
    def objectives(self) -> Float[np.ndarray, " points"]:
        """The optimum at each point, not a number where there is none."""
        return np.array([solution.objective if solution.ok else np.nan for solution in self.solutions])

    @property
    def prices(self) -> Float[np.ndarray, " points"]:
        """How much the optimum falls for each unit by which the bound is relaxed; not a number where there is none."""
        return np.array([one.multiplier(self.bound) if one.ok else np.nan for one in self.solutions])

    @property
    def violations(self) -> Float[np.ndarray, " points"]:
        """The scaled violation at each point: the least one found where the problem is infeasible.

        Not a number where it was refused.
        """
        return np.array([solution.violation for solution in self.solutions])

    def __str__(self) -> str:
        rows = [f"{self.bound:>10} {'objective':>12} {'price':>10}  active"]
        rows += [_row(self, *point) for point in zip(self.values, self.solutions, strict=True)]
        return "\n".join(rows)


def _row(front: Front, value: float, solution: Solution) -> str:
    if not solution.ok:
        return f"{value:10.5g} {solution.status.name.lower().replace('_', ' '):>12}  {solution.why()}"
    price = solution.multiplier(front.bound)
    return f"{value:10.5g} {solution.objective:12.6g} {price:10.4g}  {', '.join(solution.active)}"


def pareto(
    problem: Problem,
    bound: str,
    values: Sequence[float] | Float[np.ndarray, " points"],
    *,
    solver: AbstractSolver | None = None,
    progress: Progress = silent,
) -> Front:
    """Solve a problem for each value of the bound called `bound`, each from the nearest solution found so far.

    The problem is compiled once: bounds are data. A point that fails is tried again from the problem's own start, and
    then kept with its status, its least violation and the reason. One that is refused, because no decision can meet the
    bound, is kept as infeasible with what was said. Ctrl-C ends the sweep and returns the points that are finished, if
    there are any.

    A value given twice is solved once. Raises `ProblemError` if there is no such constraint or no value, or if every
    point is refused.
    """
    one_of("pareto: problem", problem, Problem)
    a_name("pareto: bound", bound)
    bounds = list(dict.fromkeys(np.ravel(real_array("pareto: values", values)).tolist()))
    if not bounds:
        raise ProblemError("pareto: expected at least one value of the bound; received none.")
    problem = current(problem)
    problems = [problem.with_bound(bound, value) for value in bounds]
    solutions: dict[float, Solution] = {}
    refused: dict[float, ProblemError] = {}
    interrupted = True
    try:
        with heeding() as heed:
            for done, (one, value) in enumerate(zip(problems, bounds, strict=True)):
                progress(f"front over {bound}", done, len(bounds))
                refuse_changed("pareto", one, "when the front was begun")
                try:
                    solutions[value] = _point(one, _nearest(solutions, value), solver)
                except ProblemError as error:
                    refused[value] = error
                heed()
        interrupted = False
        progress(f"front over {bound}", len(bounds), len(bounds))
    except KeyboardInterrupt:
        if not solutions:
            raise
    if refused and not solutions:
        raise next(iter(refused.values()))
    for one, value in zip(problems, bounds, strict=True):
        if value in refused:
            solutions[value] = _without_design(one, refused[value], next(iter(solutions.values())))
    finished = [value for value in bounds if value in solutions]
    return Front(bound, np.array(finished), tuple(solutions[value] for value in finished), interrupted)


def _without_design(problem: Problem, error: ProblemError, other: Solution) -> Solution:
    """A point that was refused: as `other`, a finished one, without its numbers, and with what was said."""
    nothing = np.full(other.vector.shape, np.nan)
    named = problem.survey.named(nothing)
    return replace(
        other,
        problem=problem,
        status=Status.INFEASIBLE,
        decisions=named,
        vector=nothing,
        objective=np.nan,
        constraints=(),
        moments={},
        statistics={},
        at_bounds=(),
        bound_multipliers=named,
        multipliers=np.full(other.multipliers.shape, np.nan),
        violation=np.nan,
        stationarity=np.nan,
        complementarity=np.nan,
        iterations=0,
        evaluations=0,
        times=Times(0.0, 0.0, 0.0),
        solver="refused before it was solved",
        message=str(error).removesuffix("."),
        between=None,
    )


def _nearest(solutions: Mapping[float, Solution], value: float) -> Solution | None:
    """The solved point whose bound is nearest."""
    solved = {bound: solution for bound, solution in solutions.items() if solution.ok}
    return solved[min(solved, key=lambda bound: abs(bound - value))] if solved else None


def _point(problem: Problem, neighbour: Solution | None, solver: AbstractSolver | None) -> Solution:
    """The solution at one point; where it fails from the neighbour and from the start, the less violated of the two."""
    first = solve(problem, solver, warm_start=neighbour, throw=False)
    if first.ok or neighbour is None:
        return first
    second = solve(problem, solver, throw=False)
    return second if second.ok or second.violation < first.violation else first
