"""Designs that lead to a front: solving one compromise; the anchors, which are the best designs of each wish, at which
the others are as good as they can be without making it worse; and a population from which lines lead to the front.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.errors import ProblemError
from aleator._core.interruption import answering
from aleator.nlp import AbstractSolver, DifferentialEvolution, NonlinearProgram, Slsqp, population_front, variable_range
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._portfolio import portfolio
from aleator.sweep._runner import Runner, finished
from aleator.sweep._trade_off import efficient, far_apart
from aleator.sweep._wishes import LEVEL, Compromise, Design, Wishes, without_level
from aleator.transcription import DEFAULT, AbstractTranscription, transcribe, valued_by

Start: TypeAlias = Solution | Mapping[str, Any] | None


@final
@dataclass(frozen=True)
class Seeker:
    """Solves problems of a front: by a solver, or the default ones for None; with so many local searches each.

    An executor does several of these at once.
    """

    transcription: AbstractTranscription
    solver: AbstractSolver | None
    starts: int
    executor: Executor | None

    def sought(self, compromise: Compromise, start: Start) -> tuple[Design | None, str]:
        """The design of a compromise; or None, and why."""
        solution = self._local(compromise, start)
        if self.starts > 1:
            own = {"solver": self.solver, "executor": self.executor}
            other = portfolio(compromise.problem, self.starts, search=None, **own).best
            solution = min((solution, other), key=lambda one: (not one.ok, one.objective))
        return (compromise.design(solution), "") if solution.ok else (None, solution.why())

    def _local(self, compromise: Compromise, start: Start) -> Solution:
        """The first solution from a start, from the problem's own, and by SLSQP, which makes ever longer steps where
        wishes are linear, as others do not; the last one if none is solved.
        """
        solver, solution = self.solver, None
        tries = [(solver, start), *([] if start is None else [(solver, None)]), *([] if solver else [(Slsqp(), start)])]
        for by, begun in tries:
            design = {"warm_start": begun} if isinstance(begun, Solution) else {"start": begun}
            own = {"transcription": self.transcription, "throw": False}
            solution = finished(solve(compromise.problem, by, **design, **own))
            if solution.ok:
                break
        assert solution is not None
        return solution


# A wish of a smaller range, as a part of its magnitude, is constant; an improvement by less of the range is none.
_CONSTANT, SAME = 1e-9, 1e-5
# What a wish may give up, as a part of its range, while the others are improved. An improvement that is not many times
# what the price of the wish makes of that has been bought by it.
_GIVEN_UP, _BOUGHT, _STEEPER = 1e-7, 20.0, 1.1
# Slopes of this part of a wish's magnitude, over the range of a decision, are rounding; random points to look at.
_STILL, _POINTS = 1e-12, 4


@final
class Anchors:
    """The best designs of the wishes, in the order of the wishes: none where it has not been found yet.

    - `designs`: in two rounds: each wish alone, then the others as well while it is held (lexicographic order);
    - `least`: the least value of each wish alone, infinite where it is not known yet.
    """

    def __init__(self, wishes: Wishes, seeker: Seeker):
        self._wishes, self._seeker = wishes, seeker
        self._sizes = np.ones(len(wishes.names))  # the magnitudes of the wishes around the start
        self.designs: list[Design] = []
        self.least = np.full(len(wishes.names), np.inf)

    @property
    def values(self) -> Float[np.ndarray, "anchors wishes"]:
        """The wishes there, in their own units."""
        return np.array([one.values for one in self.designs])

    @property
    def range(self) -> Float[np.ndarray, " wishes"]:
        """The range of each wish."""
        return np.ptp(self.values, axis=0)

    @property
    def scales(self) -> Float[np.ndarray, " wishes"]:
        """By which wishes are multiplied: over their ranges, or their magnitudes where they are constant."""
        return 1.0 / np.where(self.constant, self._magnitudes, self.range)

    @property
    def constant(self) -> Bool[np.ndarray, " wishes"]:
        """Which wishes differ by rounding alone."""
        return self.range <= _CONSTANT * self._magnitudes

    @property
    def _magnitudes(self) -> Float[np.ndarray, " wishes"]:
        return np.maximum(np.abs(self.values).max(axis=0), self._sizes)

    def find(self, run: Runner) -> None:
        """Find them all. What is found when this is interrupted is kept."""
        self._measure()
        task, count = "best of each wish", len(self._wishes.names)
        for which in range(count):
            with run.step(task, which, count, task):
                self.designs.append(self._alone(which, self._everywhere(which)))
        with run.step(task, count, count, task):
            self._settle_rivals()
        scales = self.scales
        for which in range(count if not self.constant.all() else 0):
            with run.step(task, which, count, task):
                self.designs[which] = self._improved(which, scales)

    def _measure(self) -> None:
        """The magnitudes of the wishes around the problem's start. Refuses wishes that nothing changes."""
        count = len(self._wishes.names)
        problem = self._wishes.weighted(np.zeros(count), np.ones(count)).problem
        transcribed = transcribe(problem, self._seeker.transcription)
        first = len(problem.constraints) - count - 1
        found = np.array(transcribed.scales[first : first + count])
        self._sizes = np.where(np.isfinite(found) & (found > 0), found, 1.0)
        # States that are variables change whatever depends on them.
        if transcribed.program.start.size == transcribed.problem.placements.size:
            _refuse_still(self._wishes.names, transcribed.program, self._wishes.rows(transcribed), self._sizes)

    def _everywhere(self, which: int) -> Start:
        """Where a wish is least everywhere, as far as a global search tells; None if none is asked for."""
        seeker = self._seeker
        if seeker.starts == 1:
            return None
        problem = self._wishes.only(which)
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        own = {"solver": seeker.solver, "executor": seeker.executor}
        return portfolio(problem, seeker.starts, search=search, **own).best.decisions

    def _settle_rivals(self) -> None:
        """Where another's design is better in a wish than its own, which ended at a worse optimum or on a plateau, seek
        it again from there.
        """
        for which, own in enumerate(self.designs):
            rival = self.designs[int(np.argmin(self.values[:, which]))]
            if rival.values[which] < own.values[which] - SAME * self.range[which]:
                level = float(rival.values[which] / self._sizes[which])
                self.designs[which] = self._alone(which, {**rival.solution.decisions, LEVEL: level})

    def _alone(self, which: int, start: Start) -> Design:
        """The best design of a wish, whatever becomes of the others."""
        unbounded = np.full(len(self._sizes), np.inf)
        compromise = self._wishes.within(which, unbounded, 1.0 / self._sizes, share=0.0)
        design, reason = self._seeker.sought(compromise, start)
        if design is None:
            name = self._wishes.names[which]
            raise ProblemError(f"trade_off: the best design for '{name}' alone was not found: {reason}")
        self.least[which] = design.values[which]
        factors = (np.arange(len(self._sizes)) == which).astype(float)
        return design._replace(weights=np.full(len(factors), np.nan), factors=factors)

    def _improved(self, which: int, scales: Float[np.ndarray, " wishes"]) -> Design:
        """The best design of a wish after the others were improved while it is held, with the prices there."""
        alone = self.designs[which]
        others = np.arange(len(scales)) != which
        most = alone.values[which] + _GIVEN_UP / scales[which]
        start = {**alone.solution.decisions, LEVEL: float((scales * alone.values)[others].sum())}
        design, _ = self._seeker.sought(self._wishes.held(which, most, scales), start)
        if design is None:
            return alone
        better = float((scales * (alone.values - design.values))[others].sum())
        price = design.weights[which] / scales[which]
        bought = price * _GIVEN_UP
        if better > max(SAME, _BOUGHT * bought):
            return design
        # Where much more was bought than by a constant price, the front is ever steeper towards its end.
        return alone if better > max(SAME, _STEEPER * bought) else alone._replace(weights=design.weights)


def _refuse_still(
    names: Sequence[str],
    program: NonlinearProgram,
    rows: Int[np.ndarray, " wishes"],
    sizes: Float[np.ndarray, " wishes"],
) -> None:
    """Refuse wishes whose slopes are zero at the start and at random points."""
    lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
    drawn = np.random.default_rng(0).uniform(lower, upper, (_POINTS, program.start.size))
    slopes = [program.evaluate(one).jacobian[rows] * program.variable_scale for one in (program.start, *drawn)]
    still = (np.abs(slopes) <= _STILL * sizes[:, None]).all(axis=(0, 2))
    if still.any():
        name = names[int(np.argmax(still))]
        raise ProblemError(f"trade_off: wish '{name}': no decision changes it; leave it out.")


# Violations of at most this part of a constraint's magnitude count as none.
_HELD = 1e-6


class Member(NamedTuple):
    """A design of a population: its wishes, in their own units, and its decisions by name."""

    values: Float[np.ndarray, " wishes"]
    decisions: Mapping[str, Any]


def crowd(
    wishes: Wishes, anchors: Sequence[Design], points: int, evaluations: int, seed: int, run: Runner
) -> list[Member]:
    """Designs of a population spread over the front, at most `points`, as far from one another as can be.

    Ctrl-C only ends the population. `anchors`: the best designs of the wishes, of its first generation.
    """
    count = len(wishes.names)
    transcribed = transcribe(wishes.weighted(np.zeros(count), np.ones(count)).problem, DEFAULT)
    program, places = valued_by(run.executor, transcribed.program, "trade_off"), transcribed.places
    is_free = np.array([name != LEVEL for name in places.entry_names()])
    rows = wishes.rows(transcribed)
    seen: list[tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k wishes"]]] = []

    def values(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        """The wishes, and the largest violations over the magnitudes of the constraints."""
        assert program.values is not None
        every = np.repeat(program.start[None], len(free), axis=0)
        every[:, is_free] = free
        _, constraints = program.values(every)
        beyond = np.fmax(constraints - program.constraint_upper, program.constraint_lower - constraints)
        worst = np.max(beyond / program.constraint_scale, axis=1, initial=0.0)
        violations = np.where(np.isfinite(constraints).all(axis=1), worst, np.inf)
        held = violations <= _HELD
        seen.append((every[held], constraints[held][:, rows]))
        return constraints[:, rows], violations

    first = np.array([places.moved(program.start, without_level(one.solution.decisions)) for one in anchors])
    try:
        with answering() as answer:

            def heed(done: int) -> None:
                run.progress("population", done, evaluations)
                answer()

            bounds = program.lower[is_free], program.upper[is_free]
            how = {"points": points, "evaluations": evaluations, "seed": seed, "heed": heed}
            population_front(values, *bounds, first[:, is_free], **how)
    except KeyboardInterrupt:
        if not seen:
            raise
        run.interrupted = True
    every, reached = (np.concatenate(part) for part in zip(*seen, strict=True))
    kept = efficient(reached, np.zeros(count))
    every, reached = every[kept], reached[kept]
    # The anchors are on the front already.
    known = np.array([one.values for one in anchors])
    chosen = far_apart(np.concatenate([known, reached]), points, taken=len(known))
    return [Member(reached[i - len(known)], places.named(every[i - len(known)])) for i in chosen]
