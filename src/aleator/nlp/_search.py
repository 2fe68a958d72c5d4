"""The stages of a search: first points, exploration under a growing penalty, polishing, verdict."""

import abc
import contextlib
import math
import time
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core import border
from aleator._core.border import Progress, check_progress, silent
from aleator._core.errors import ProblemError
from aleator._core.parallel import heeding
from aleator.nlp._local_solver import AbstractLocalSolver
from aleator.nlp._program import NonlinearProgram
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import AbstractSolver, Outcome, Searched, Status
from aleator.nlp._sought import NEAR, EndedError, Sought
from aleator.nlp._uno import default_solver
from aleator.nlp._verdict import HELD, Answer

# Weights of the largest violation, in spreads of the objective, from one round to the next.
_WEIGHTS = (10.0, 1e3, 1e5)
# How many points are polished at most: the best of a search need not lie in the basin of the least minimum.
_POLISHED = 5
# A point of the search that is lower than the polished one by this part of the objective is better.
_LOWER = 1e-6


@final
@dataclass(frozen=True)
class _AsItIs(AbstractLocalSolver):
    """Judges the start and moves nowhere."""

    @property
    @override
    def name(self) -> str:
        return "no polishing"

    @override
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        del multipliers
        return Answer(Status.FAILED, scaled.start, message="the best point of a search without derivatives")


@dataclass(frozen=True)
class AbstractSearch(AbstractSolver):
    """Searches without derivatives, everywhere between the bounds, and polishes the best point by derivatives.

    Constraints become an exact penalty: the largest violation, in a weight that grows until the best point is almost
    feasible. The polished point is judged like that of every other solver. Ctrl-C ends the search, and the best point
    so far is polished; while a point is polished, it ends that, and the best point so far is the answer, with
    `Status.INTERRUPTED` unless one is an optimum already.

    - `tolerance`: see `AbstractSolver`;
    - `evaluations`: at most so many simulations of the problem, those of polishing not counted;
    - `seconds`: no further points are evaluated after this time;
    - `seed`: of its random numbers;
    - `polish`: whether the best point is a start of `al.solvers.FilterSQP()`; otherwise it is judged as it is, and is a
      solution only if the conditions of an optimum hold there within the tolerance;
    - `progress`: called with the task, the evaluations done and their limit.
    """

    evaluations: int = 2000
    seconds: float = math.inf
    seed: int = 0
    polish: bool = True
    progress: Progress = silent

    method: ClassVar[str]
    """Name and version of the method."""
    needs_bounds: ClassVar[bool] = True
    at_once: ClassVar[bool] = True
    """Whether it asks for many points in one call, which an executor can share."""
    first_points: ClassVar[int] = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        who = type(self).__name__
        border.whole(f"{who}: evaluations", self.evaluations)
        border.whole(f"{who}: seed", self.seed, least=0)
        if not (isinstance(self.seconds, float) and self.seconds == math.inf):
            border.positive(f"{who}: seconds", self.seconds)
        if not isinstance(self.polish, bool):
            raise border.refusal(f"{who}: polish", "True or False", self.polish)
        check_progress(who, self.progress)

    @abc.abstractmethod
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        """Look for points of low merit by `sought.merits` until that raises `EndedError`, or the method ends.

        `first`: points evaluated already, the best one first.
        """

    @property
    @override
    def name(self) -> str:
        return f"{self.method}, {self.local.name}"

    @property
    @override
    def local(self) -> AbstractSolver:
        return replace(default_solver(), tolerance=self.tolerance) if self.polish else _AsItIs(self.tolerance)

    @override
    def solve(
        self,
        program: NonlinearProgram,
        *,
        multipliers: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> Outcome:
        del multipliers  # Values know nothing of them.
        began = time.perf_counter()
        sought, searched = self.seek(program, start)
        with heeding(alone=True):
            outcome, is_cut = self._polished(program, sought)
        if is_cut:
            searched = replace(searched, end=f"{searched.end}; polishing was stopped by the user")
        return replace(
            outcome,
            evaluations=outcome.evaluations + searched.evaluations,
            seconds=time.perf_counter() - began,
            solver=self.name,
            searched=searched,
        )

    def seek(self, program: NonlinearProgram, start: np.ndarray | None = None) -> tuple[Sought, Searched]:
        """Search alone: the points found, of which none is polished, and the history."""
        self.require()
        if not isinstance(program.sparsity, np.ndarray | None):
            raise ProblemError(
                f"{type(self).__name__} searches without derivatives, and cannot hold equations of motion as limits: "
                "expected states that are simulated, by transcription=al.Sequential(); received a sparse program."
            )
        begun = program.start if start is None else start
        with heeding(alone=True) as heed:
            sought = Sought(program, begun, (self.evaluations, self.seconds), self.progress, heed)
            if sought.size:
                self._search(program, sought)
        if sought.halt is not None and not isinstance(sought.halt, KeyboardInterrupt):
            raise sought.halt
        return sought, Searched(self.method, *sought.found[1:], sought.end, sought.seconds)

    def _search(self, program: NonlinearProgram, sought: Sought) -> None:
        generator = np.random.default_rng(self.seed)
        sought.weight = _WEIGHTS[0]
        try:
            first = self._first(sought, generator)
            for weight in _WEIGHTS:
                is_last = weight == _WEIGHTS[-1] or not np.isfinite(program.limits).any()
                # Violations are weighed anew, with a share of what is left of the budget.
                left = self.evaluations - sought.count
                sought.weight, sought.limit = weight, self.evaluations - (0 if is_last else left // 2)
                with contextlib.suppress(EndedError):
                    self.explore(sought, first, generator)
                best = sought.ranked(NEAR)
                if sought.is_over or is_last or best.violations[0] <= NEAR:
                    break
                first = best.points[:1]
        except EndedError:
            pass
        except KeyboardInterrupt as interrupt:
            sought.halt = interrupt
        if isinstance(sought.halt, KeyboardInterrupt):
            sought.end = "stopped by the user"
        elif sought.is_spent:
            sought.end = "its budget was spent"

    def _first(self, sought: Sought, generator: np.random.Generator) -> Float[np.ndarray, "k size"]:
        """The start, and a Latin hypercube around it, or between the bounds: the best one first."""
        from scipy.stats import qmc  # late: it takes a third of a second

        count = max(min(self.first_points, self.evaluations) - 1, 0)
        drawn = qmc.LatinHypercube(sought.size, rng=generator).random(count) if count else np.zeros((0, sought.size))
        drawn = np.where(np.isfinite(sought.upper - sought.lower), drawn, sought.start + 2 * drawn - 1)
        points = np.concatenate([sought.start[None], np.clip(drawn, sought.lower, sought.upper)])
        return points[np.argsort(sought.merits(points), kind="stable")]

    def _polished(self, program: NonlinearProgram, sought: Sought) -> tuple[Outcome, bool]:
        """The best of a few points that are far apart, polished, or that of the search, with the effort of all; and
        whether the user stopped polishing.
        """
        outcomes, is_cut = list[Outcome](), False
        try:
            for point in sought.candidates(_POLISHED if self.polish else 1):
                outcomes.append(self.local.solve(program, start=point))
                if is_cut := outcomes[-1].status is Status.INTERRUPTED:
                    break
        except KeyboardInterrupt:
            is_cut = True
        seen = sought.ranked(HELD)
        lowest = seen.objectives[0] if seen.violations[0] <= HELD else np.inf
        best = min([one for one in outcomes if one.ok] or outcomes, key=_rank, default=None)
        reached = best.evaluation.objective if best is not None and best.violation <= HELD else np.nan
        if best is None or not reached <= lowest + _LOWER * max(abs(lowest), abs(reached)):
            # Polishing may end above the search's best point, or at none that holds, where the model is not smooth.
            outcomes.append(_AsItIs(self.tolerance).solve(program, start=sought.unscaled(seen.points[:1])[0]))
            best = min(outcomes, key=_rank)
        best = best.with_effort_of(*(one for one in outcomes if one is not best))
        if is_cut and not best.ok:
            best = replace(best, status=Status.INTERRUPTED, message="the best point so far")
        return best, is_cut


def _rank(outcome: Outcome) -> tuple[bool, float]:
    """Feasible ones first, by objective; the others by violation."""
    held = outcome.violation <= HELD
    size = outcome.evaluation.objective if held else float(np.nan_to_num(outcome.violation, nan=np.inf))
    return not held, size
