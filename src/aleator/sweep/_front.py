"""`pareto`: one problem for many values of a bound (the constraint form of multi-objective design, section 3.5.1)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.given import a_name, one_of, real_array
from aleator._core.heard import heeding
from aleator._core.progress import Progress, check_progress, silent
from aleator._core.shown import Drawn, Printed
from aleator._core.warned import warned_of
from aleator.design import Problem, current, refuse_changed
from aleator.nlp import AbstractSolver, Status
from aleator.solution import Solution
from aleator.solving import solve
from aleator.transcription import DEFAULT, AbstractTranscription


@final
@dataclass(frozen=True)
class Refused(Printed):
    """A point of a front that was refused before it was solved, because no decision can meet the bound.

    - `problem`: the problem with that bound; `reason`: the message.
    """

    problem: Problem
    reason: str

    @property
    def ok(self) -> bool:
        """Whether there is a certified optimum: never."""
        return False

    @property
    def status(self) -> Status:
        """The status: no design exists there."""
        return Status.INFEASIBLE

    def why(self) -> str:
        """Why there is no design."""
        return f"{self.status.value}. {self.reason}"

    def __str__(self) -> str:
        return f"Refused before it was solved: {self.reason}"


@final
@dataclass(frozen=True)
class Front(Drawn):
    """Optimal designs along a bound. `print(front)` shows them.

    - `bound`: the name of the constraint; `values`: its bounds, shape (points,);
    - `points`: the result at each: a solution, even where the problem is infeasible (see `Solution.status` and
      `Solution.why()`), or `Refused`;
    - `interrupted`: whether the sweep was stopped early; the points finished by then are included.
    """

    bound: str
    values: Float[np.ndarray, " points"]
    points: tuple[Solution | Refused, ...]
    interrupted: bool = False

    @property
    def solutions(self) -> tuple[Solution, ...]:
        """The points that were solved, successfully or not."""
        return tuple(one for one in self.points if isinstance(one, Solution))

    @property
    def optima(self) -> tuple[Solution | None, ...]:
        """The certified optimum at each point; None where there is none."""
        return tuple(one if isinstance(one, Solution) and one.ok else None for one in self.points)

    @property
    def solved(self) -> np.ndarray:
        """Which points have a certified optimum."""
        return np.array([one.ok for one in self.points], dtype=bool)

    @property
    def objectives(self) -> Float[np.ndarray, " points"]:
        """The optimum at each point; NaN where there is none."""
        return self._numbers(lambda one: one.objective if one.ok else np.nan)

    @property
    def shadow_prices(self) -> Float[np.ndarray, " points"]:
        """The decrease of the optimum per unit by which the bound is relaxed; NaN where there is none."""
        return self._numbers(lambda one: one.multiplier(self.bound) if one.ok else np.nan)

    @property
    def violations(self) -> Float[np.ndarray, " points"]:
        """The scaled violation at each point; where the problem is infeasible, the smallest found.

        NaN where it was refused.
        """
        return self._numbers(lambda one: one.certificate.violation)

    def _numbers(self, measure: Callable[[Solution], float]) -> Float[np.ndarray, " points"]:
        """A number for each point; NaN where it was refused."""
        return np.array([measure(one) if isinstance(one, Solution) else np.nan for one in self.points])

    def __str__(self) -> str:
        rows = [f"{self.bound:>10} {'objective':>12} {'shadow price':>12}  active"]
        rows += [_row(self, *point) for point in zip(self.values, self.points, strict=True)]
        return "\n".join(rows)


def _row(front: Front, value: float, solution: Solution | Refused) -> str:
    if isinstance(solution, Refused) or not solution.ok:
        return f"{value:10.5g} {solution.status.name.lower().replace('_', ' '):>12}  {solution.why()}"
    shadow_price = solution.multiplier(front.bound)
    return f"{value:10.5g} {solution.objective:12.6g} {shadow_price:12.4g}  {', '.join(solution.active)}"


def pareto(
    problem: Problem,
    bound: str,
    values: Sequence[float] | Float[np.ndarray, " points"],
    *,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    progress: Progress = silent,
) -> Front:
    """Solve a problem for each value of the bound called `bound`, starting from the nearest solution so far.

    The problem is compiled once, since bounds are data. A point that fails is tried again from the problem's own start,
    and then kept with its status, its smallest violation and the reason. One that is refused, because no decision can
    meet the bound, is kept as `Refused` with the message. Ctrl-C ends the sweep and returns the finished points, if
    there are any. `solver` and `transcription` are those of `al.solve`.

    A value given twice is solved once. Raises `ProblemError` if there is no such constraint or no value, or if every
    point is refused.
    """
    one_of("pareto: problem", problem, Problem)
    a_name("pareto: bound", bound)
    check_progress("pareto", progress)
    bounds = list(dict.fromkeys(np.ravel(real_array("pareto: values", values)).tolist()))
    if not bounds:
        raise ProblemError("pareto: expected at least one value of the bound; received none.")
    problem, solved = current(problem), partial(solve, solver=solver, transcription=transcription, throw=False)
    problems = [problem.with_bound(bound, value) for value in bounds]
    solutions: dict[float, Solution] = {}
    refused: dict[float, Refused] = {}
    first: ProblemError | None = None
    interrupted = True
    try:
        with heeding() as heed:
            for done, (one, value) in enumerate(zip(problems, bounds, strict=True)):
                progress(f"front over {bound}", done, len(bounds))
                refuse_changed("pareto", one, "when the front was begun")
                try:
                    with warned_of(f"pareto, at {bound} = {value:g}"):
                        solutions[value] = _point(one, _nearest(solutions, value), solved)
                except ProblemError as error:
                    first = first or error
                    refused[value] = Refused(one, str(error))
                heed()
        interrupted = False
        progress(f"front over {bound}", len(bounds), len(bounds))
    except KeyboardInterrupt:
        if not solutions:
            raise
    if first is not None and not solutions:
        raise first
    points = solutions | refused
    finished = [value for value in bounds if value in points]
    return Front(bound, np.array(finished), tuple(points[value] for value in finished), interrupted)


def _nearest(solutions: Mapping[float, Solution], value: float) -> Solution | None:
    """The solved point whose bound is nearest."""
    solved = {bound: solution for bound, solution in solutions.items() if solution.ok}
    return solved[min(solved, key=lambda bound: abs(bound - value))] if solved else None


def _point(problem: Problem, neighbour: Solution | None, solved: Callable[..., Solution]) -> Solution:
    """The solution at one point; if it fails from the neighbour and from the start, the less violated of the two."""
    first = solved(problem, warm_start=neighbour)
    if first.ok or neighbour is None:
        return first
    second = solved(problem)
    return second if second.ok or second.certificate.violation < first.certificate.violation else first
