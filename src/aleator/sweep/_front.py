"""`pareto`: one problem for many values of a bound (the constraint form of multi-objective design, section 3.5.1)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.elsewhere import check_executor
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.given import a_name, one_of, real_array
from aleator._core.heard import heeding
from aleator._core.journalled import expected
from aleator._core.progress import Progress, check_progress, silent
from aleator._core.shown import Drawn, Printed
from aleator._core.warned import warned_of
from aleator.design import Problem, current, refuse_changed
from aleator.nlp import AbstractSolver, Status
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.sweep._elsewhere import as_they_come
from aleator.sweep._plan import Plan
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
        return "\n".join([*rows, *(["interrupted by the user"] if self.interrupted else [])])


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
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Front:
    """Solve a problem for each value of the bound called `bound`, starting from the nearest solution so far.

    The problem is compiled once, since bounds are data. A point that fails is tried again from the problem's own start,
    and then kept with its status, its smallest violation and the reason. One that is refused, because no decision can
    meet the bound, is kept as `Refused` with the message. Ctrl-C ends the sweep and returns the finished points, if
    there are any. `solver` and `transcription` are those of `al.solve`.

    With an `executor` (`al.workers(2)`, loky's, Dask's `client.get_executor()`, any of `concurrent.futures`), its
    workers solve points from coarse to fine: the first value, then the ends, then the middles between, each from the
    nearest of those before, as soon as this one is there; those that fail are tried again here. The front is the same
    for every executor.

    A value given twice is solved once. Raises `ProblemError` if there is no such constraint or no value, or if every
    point is refused.
    """
    one_of("pareto: problem", problem, Problem)
    a_name("pareto: bound", bound)
    check_progress("pareto", progress)
    bounds = list(dict.fromkeys(np.ravel(real_array("pareto: values", values)).tolist()))
    if not bounds:
        raise ProblemError("pareto: expected at least one value of the bound; received none.")
    check_executor("pareto", executor)
    problem, own = current(problem), {"solver": solver, "transcription": transcription}
    sweep = _Sweep(bound, {value: problem.with_bound(bound, value) for value in bounds}, own, progress)
    interrupted = True
    try:
        with expected("solve", sweep.named), heeding() as heed:
            sweep.solve_here(heed) if executor is None else sweep.solve_by(executor, heed)
        interrupted = False
        sweep.tell()
    except KeyboardInterrupt:
        if not sweep.solutions:
            raise
    return sweep.front(interrupted)


@final
class _Sweep:
    """A front in the making: its problems, and what was found, by the values of the bound."""

    def __init__(self, bound: str, problems: Mapping[float, Problem], own: Mapping[str, Any], progress: Progress):
        self._bound, self._problems, self._own, self._progress = bound, problems, own, progress
        self.solutions: dict[float, Solution] = {}
        self._refused: dict[float, Refused] = {}
        self._first: ProblemError | None = None
        self._last = ""

    @property
    def named(self) -> dict[str, Problem]:
        """The problems by the values of their bounds, in words."""
        return {f"{self._bound} = {value:.6g}": one for value, one in self._problems.items()}

    def solve_here(self, heed: Callable[[], None]) -> None:
        """Solve each point in this process, from the nearest one before."""
        for value in self._problems:
            self._point(value)
            heed()

    def solve_by(self, executor: Executor, heed: Callable[[], None]) -> None:
        """Solve points by workers, each once the one is known from which it starts, then those that failed here."""
        plan, begun = Plan(list(self._problems)), list[float]()

        def more() -> Iterator[tuple[Mapping[str, Any], str]]:
            finished = {value: one.ok for value, one in (self.solutions | self._refused).items()}
            for value, nearest in plan.ready(finished):
                begun.append(value)
                yield self._call(value, None if nearest is None else self.solutions[nearest]), self._place(value)

        for i, found in as_they_come("solve", executor, more, rehearsed=True):
            self._keep(begun[i], found)
            self.tell()
            heed()
        for value in [value for value, one in self.solutions.items() if not one.ok]:
            self._point(value)
            heed()

    def front(self, interrupted: bool) -> Front:
        """What was found, in the order of the bounds. Raises the first refusal if every point was refused."""
        if self._first is not None and not self.solutions:
            raise self._first
        points = self.solutions | self._refused
        finished = [value for value in self._problems if value in points]
        return Front(self._bound, np.array(finished), tuple(points[value] for value in finished), interrupted)

    def _call(self, value: float, neighbour: Solution | None) -> dict[str, Any]:
        return {"problem": self._problems[value], "warm_start": neighbour, **self._own}

    def _place(self, value: float) -> str:
        return f"pareto, at {self._bound} = {value:g}"

    def tell(self) -> None:
        """Report how far the front is, and its last point."""
        done = len(self.solutions) + len(self._refused)
        self._progress(f"front over {self._bound}{self._last}", done, len(self._problems))

    def _point(self, value: float) -> None:
        """Solve one point here; if it fails from the neighbour and the start, keep the less violated of the two."""
        self.tell()
        refuse_changed("pareto", self._problems[value], "when the front was begun")
        neighbour = _nearest(self.solutions, value)
        try:
            with warned_of(self._place(value)):
                found = solve(**self._call(value, neighbour), throw=False)
                if found.status is Status.INTERRUPTED:
                    self._keep(value, found)
                    raise KeyboardInterrupt
                if not found.ok and neighbour is not None:
                    found = _better(solve(**self._call(value, None), throw=False), found)
        except ProblemError as error:
            self._keep(value, error)
        else:
            self._keep(value, found)

    def _keep(self, value: float, found: Solution | AleatorError) -> None:
        if isinstance(found, Solution):
            before = self.solutions.get(value)
            self.solutions[value] = found if before is None else _better(found, before)
            self._last = f": {self._bound} = {value:.6g}, {in_brief(self.solutions[value])}"
        elif isinstance(found, ProblemError):
            self._first = self._first or found
            self._refused[value] = Refused(self._problems[value], str(found))
            self._last = f": {self._bound} = {value:.6g}, no design"
        else:
            raise found


def _nearest(solutions: Mapping[float, Solution], value: float) -> Solution | None:
    """The solved point whose bound is nearest."""
    solved = {bound: solution for bound, solution in solutions.items() if solution.ok}
    return solved[min(solved, key=lambda bound: abs(bound - value))] if solved else None


def _better(second: Solution, first: Solution) -> Solution:
    return second if second.ok or second.certificate.violation < first.certificate.violation else first
