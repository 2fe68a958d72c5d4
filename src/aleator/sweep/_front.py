"""`pareto`: designs for several bounds of one constraint, each solved from neighbours that are solved."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, a_name, one_of, real_array, refusal, silent
from aleator._core.errors import ProblemError
from aleator._core.leaves import Drawn, Printed
from aleator.design import Problem
from aleator.nlp import AbstractSolver, Status
from aleator.solution import Solution
from aleator.sweep._printed import table
from aleator.sweep._runner import SOLVE, Runner, running
from aleator.transcription import DEFAULT, AbstractTranscription

# Objectives with a smaller difference, as a part of the largest on the front, are the same: solvers leave that much.
SAME = 1e-6
# By so much of the steeper of two prices, times the step between them, an optimum may be above what both say: a front
# is a smooth curve, along which the mean of two slopes is off by a twelfth of its third derivative.
_OFF = 0.05


@final
@dataclass(frozen=True)
class Refused(Printed):
    """A point of a front that was refused before it was solved, because no decision can meet the bound.

    - `problem`: the problem with that bound; `reason`: the message; `ok`, `status`: those of a solution, never solved.
    """

    problem: Problem
    reason: str
    ok: ClassVar[bool] = False
    status: ClassVar[Status] = Status.INFEASIBLE

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
    - `interrupted`: whether the sweep was stopped early; the points finished by then are included;
    - `neighbours`: for each point the bound whose design led to it; None if that was the problem's own start.
    """

    bound: str
    values: Float[np.ndarray, " points"]
    points: tuple[Solution | Refused, ...]
    interrupted: bool = False
    neighbours: tuple[float | None, ...] = ()

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
        return np.array([np.nan if one is None else one.objective for one in self.optima])

    @property
    def shadow_prices(self) -> Float[np.ndarray, " points"]:
        """The decrease of the optimum per unit by which the bound is relaxed; NaN where there is none."""
        return np.array([np.nan if one is None else one.multiplier(self.bound) for one in self.optima])

    @property
    def violations(self) -> Float[np.ndarray, " points"]:
        """The scaled violation at each point; where the problem is infeasible, the smallest found.

        NaN where it was refused.
        """
        return np.array([one.certificate.violation if isinstance(one, Solution) else np.nan for one in self.points])

    def doubts(self) -> tuple[str, ...]:
        """What speaks for better designs than these: sentences, without a capital letter and a full stop."""
        points = zip(self.values, self.solved, self.neighbours, strict=False)
        bettered = [f"{value:.6g}" for value, is_solved, near in points if is_solved and near is not None]
        if not bettered:
            return ()
        return (
            f"several local optima: at {self.bound} = {', '.join(bettered)} the design of a neighbour led to a better "
            "one than the problem's own start, and others may be better still; al.multistart and al.portfolio look for "
            "them",
        )

    def __str__(self) -> str:
        rows = [(self.bound, "objective", "shadow price", "active")]
        for value, point, optimum in zip(self.values, self.points, self.optima, strict=True):
            if optimum is None:
                rows.append((f"{value:.5g}", "no optimum", "", point.why()))
            else:
                price, active = optimum.multiplier(self.bound), ", ".join(optimum.active)
                rows.append((f"{value:.5g}", f"{optimum.objective:.6g}", f"{price:.4g}", active))
        return table(rows, *(f"{one[0].upper()}{one[1:]}." for one in self.doubts()), interrupted=self.interrupted)


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
    """Solve a problem for each value of the bound called `bound`, and let neighbours better each other.

    The problem is compiled once, since bounds are data. Each point is solved from the problem's own start, so that none
    is worse than what `al.solve` finds there. A point without an optimum, one that is worse than one with a tighter
    limit, or that is above what its own price and a neighbour's say, is solved again from that neighbour's design, and
    the better of both is kept (`Front.neighbours`). A point that fails from everywhere is kept with its status, its
    smallest violation and the reason. One that is refused, because no decision can meet the bound, is kept as `Refused`
    with the message. Ctrl-C ends the sweep and returns the finished points, if there are any. `solver` and
    `transcription` are those of `al.solve`.

    With an `executor` (`al.workers(2)`, loky's, Dask's `client.get_executor()`, any of `concurrent.futures`), its
    workers solve several points at once. The front is the same as without one.

    A value given twice is solved once. Raises `ProblemError` if there is no such constraint or no value, or if every
    point is refused.
    """
    one_of("pareto: problem", problem, Problem)
    a_name("pareto: bound", bound)
    numbers = real_array("pareto: values", values)
    if numbers.ndim > 1:
        raise refusal("pareto: values", "one number a point (give the sides of a range names of their own)", values)
    bounds = list(dict.fromkeys(np.ravel(numbers).tolist()))
    if not bounds:
        raise ProblemError("pareto: expected at least one value of the bound; received none.")
    problems = {value: problem.with_bound(bound, value) for value in bounds}
    sweep = _Sweep(bound, problems, {"solver": solver, "transcription": transcription})
    with running("pareto", lambda: sweep.solutions, progress, executor) as run:
        sweep.run(run)
    values = [value for value in bounds if value in sweep.points]
    points, neighbours = zip(*(sweep.points[value] for value in values), strict=True)
    if isinstance(points[0], Refused) and not sweep.solutions:
        raise ProblemError(points[0].reason)
    return Front(bound, np.array(values), points, run.interrupted, neighbours)


@final
@dataclass(eq=False)
class _Sweep:
    """What is known of a front, by the values of its bound: `points`, each with the bound of the design that led to it.

    - `problems`: by these values; `own`: further arguments of each solve.
    """

    bound: str
    problems: Mapping[float, Problem]
    own: Mapping[str, Any]
    points: dict[float, tuple[Solution | Refused, float | None]] = field(default_factory=dict)

    @property
    def solutions(self) -> dict[float, Solution]:
        """What has been solved."""
        return {value: one for value, (one, _) in self.points.items() if isinstance(one, Solution)}

    def run(self, run: Runner) -> None:
        """Solve each point from the problem's own start, then those from a neighbour that this may better.

        A point is tried from each design of a neighbour once, until none is bettered any more.
        """
        self._each([(value, None) for value in self.problems], run)
        tried, bettered = set[tuple[float, ...]](), True
        while bettered:
            known = self.solutions
            again = {(value, near, known[near].objective): (value, near) for value, near in self._doubtful()}
            pairs = [pair for key, pair in again.items() if key not in tried]
            tried.update(again)
            bettered = bool(pairs) and self._each(pairs, run)

    def _each(self, tries: Sequence[tuple[float, float | None]], run: Runner) -> bool:
        """Solve some points, each from the design of a neighbour or its own start; whether one has been bettered."""
        known, bettered = self.solutions, False
        calls = [
            {"problem": self.problems[value], "warm_start": None if near is None else known[near], **self.own}
            for value, near in tries
        ]
        places = [f"at {point_name(self.bound, value)}" for value, _ in tries]
        task = f"front over {self.bound}"
        if tries[0][1] is not None:
            places = [f"{place}, from {near:.6g}" for place, (_, near) in zip(places, tries, strict=True)]
            task += ", from neighbours"
        for i, found in run.each(SOLVE, task, calls, places, accepted=ProblemError):
            (value, near), (before, _) = tries[i], self.points.get(tries[i][0], (None, None))
            refused = isinstance(found, ProblemError)
            if isinstance(before, Solution) and (refused or not self._is_better(found, before)):
                continue
            self.points[value] = Refused(self.problems[value], str(found)) if refused else found, near
            bettered = True
        return bettered

    def _is_better(self, found: Solution, known: Solution) -> bool:
        if found.ok and known.ok:
            return found.objective < known.objective - SAME * self._size
        return found.ok or (not known.ok and found.certificate.violation < known.certificate.violation)

    @property
    def _size(self) -> float:
        """The largest objective on the front."""
        return max((abs(one.objective) for one in self.solutions.values() if one.ok), default=0.0)

    def _doubtful(self) -> Iterator[tuple[float, float]]:
        """The bounds of points that the design of a solved neighbour may better, each with the bound of this neighbour.

        These are points without an optimum beside one that has one (behind another without, limits are tighter still,
        or it is bettered first), those worse than a tighter neighbour, whose design is theirs too, and those worse than
        the neighbour's optimum, moved by the mean of both slopes. What a certificate objects to holds from any start.
        """
        known = {value: one if one.status is Status.SOLVED else None for value, one in sorted(self.solutions.items())}
        ordered = list(known)
        for i, value in enumerate(ordered):
            for side in (ordered[:i][::-1], ordered[i + 1 :]):
                own, solved = known[value], [near for near in side if known[near] is not None]
                if not solved or (own is None and solved[0] != side[0]):
                    continue
                neighbour = known[solved[0]]
                assert neighbour is not None
                if own is None or self._is_above(value - solved[0], own, neighbour):
                    yield value, solved[0]

    def _is_above(self, step: float, own: Solution, neighbour: Solution) -> bool:
        """Whether an optimum is worse than one a `step` away in the bound lets expect."""
        limits, rounding = own.problem.named(self.bound), SAME * self._size
        # 1 if a larger value of the bound is a weaker limit, -1 if a smaller one is, 0 for equalities.
        relaxing = int(any(np.isfinite(float(one.upper)) for one in limits))
        relaxing -= int(any(np.isfinite(float(one.lower)) for one in limits))
        risen = own.objective - neighbour.objective
        # A shadow price is the decrease for each unit of relaxation.
        slopes = [-(relaxing or 1) * one.multiplier(self.bound) for one in (own, neighbour)]
        beyond = risen - step * sum(slopes) / 2
        return (step * relaxing > 0 and risen > rounding) or beyond > _OFF * abs(step * max(slopes, key=abs)) + rounding


def point_name(bound: str, value: float) -> str:
    """What a point of a front is called, in progress, journals and evidence."""
    return f"{bound} = {value:.6g}"
