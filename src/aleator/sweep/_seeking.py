"""Solving the problems that lead to points of a front, first to its anchors: the best design of each wish, at which the
others are as good as they can be without making it worse; and a population from which lines lead to the front.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.errors import ProblemError
from aleator._core.interruption import answering
from aleator.design import Problem
from aleator.nlp import (
    AbstractSearch,
    AbstractSolver,
    DifferentialEvolution,
    NonlinearProgram,
    Slsqp,
    load_pymoo,
    population_front,
    variable_range,
)
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._portfolio import portfolio
from aleator.sweep._runner import Runner, finished
from aleator.sweep._starts import Portfolio
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
        solution = self._local(compromise.problem, start)
        if self.starts > 1:
            other = self._portfolio(compromise.problem, None).best
            solution = min((one for one in (solution, other)), key=lambda one: (not one.ok, one.objective))
        return (compromise.design(solution), "") if solution.ok else (None, solution.why())

    def everywhere(self, problem: Problem) -> Start:
        """Where an objective is least everywhere, as far as a global search tells; None if none is asked for."""
        if self.starts == 1:
            return None
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        return self._portfolio(problem, search).best.decisions

    def _portfolio(self, problem: Problem, search: AbstractSearch | None) -> Portfolio:
        return portfolio(problem, self.starts, search=search, solver=self.solver, executor=self.executor)

    def _local(self, problem: Problem, start: Start) -> Solution:
        """The first solution of the ways tried; the last one if none is."""
        solution = None
        for solver, begun in self._ways(start):
            design = begun if isinstance(begun, Solution) else None
            values = None if isinstance(begun, Solution) else begun
            own = {"transcription": self.transcription, "warm_start": design, "start": values}
            solution = finished(solve(problem, solver, **own, throw=False))
            if solution.ok:
                break
        assert solution is not None
        return solution

    def _ways(self, start: Start) -> Iterator[tuple[AbstractSolver | None, Start]]:
        """Solvers and starts to be tried; SLSQP makes ever longer steps where wishes are linear, others do not."""
        yield self.solver, start
        if start is not None:
            yield self.solver, None
        if self.solver is None:
            yield Slsqp(), start


def between(solutions: Sequence[Solution]) -> Mapping[str, Any] | None:
    """The means of the decisions of some solutions; None if they are of different shapes."""
    every = [one.decisions for one in solutions]
    if any(np.shape(one[name]) != np.shape(value) for one in every for name, value in every[0].items()):
        return None
    return {name: np.mean([one[name] for one in every], axis=0)[()] for name in every[0]}


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
    - `sizes`: the magnitudes of the wishes around the start; `least`: the least value of each wish alone, infinite
      where it is not known yet.
    """

    def __init__(self, wishes: Wishes, seeker: Seeker):
        self._wishes, self._seeker = wishes, seeker
        self.designs: list[Design] = []
        self.sizes = np.ones(len(wishes.names))
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
        return 1.0 / np.where(self.constant, np.maximum(np.abs(self.values).max(axis=0), self.sizes), self.range)

    @property
    def constant(self) -> Bool[np.ndarray, " wishes"]:
        """Which wishes differ by rounding alone, beside their values and their sizes at the start."""
        return self.range <= _CONSTANT * np.maximum(np.abs(self.values).max(axis=0), self.sizes)

    def find(self, run: Runner) -> None:
        """Find them all. What is found when this is interrupted is kept."""
        self._measure()
        count = len(self._wishes.names)

        def step(which: int) -> AbstractContextManager[None]:
            return run.step("best of each wish", which, count, "best of each wish")

        for which in range(count):
            with step(which):
                self.designs.append(self._alone(which, self._seeker.everywhere(self._wishes.only(which))))
                self.least[which] = self.designs[which].values[which]
        with step(count):
            self._settle_rivals()
        scales = self.scales
        if self.constant.all():
            return
        for which in range(count):
            with step(which):
                self.designs[which] = self._improved(which, scales)

    def _measure(self) -> None:
        """The magnitudes of the wishes around the problem's start. Refuses wishes that nothing changes."""
        transcribed = transcribe(self._wishes.unscaled().problem, self._seeker.transcription)
        found = np.array([transcribed.scales[i] for i in self._wishes.places(transcribed.problem)])
        self.sizes = np.where(np.isfinite(found) & (found > 0), found, 1.0)
        rows = self._wishes.rows(transcribed)
        # States that are variables change whatever depends on them.
        if transcribed.program.start.size == transcribed.problem.placements.size:
            _refuse_still(self._wishes.names, transcribed.program, rows, self.sizes)

    def _settle_rivals(self) -> None:
        """Where another's design is better in a wish than its own, which ended at a worse optimum or on a plateau, seek
        it again from there.
        """
        for which, own in enumerate(self.designs):
            rival = self.designs[int(np.argmin(self.values[:, which]))]
            if rival.values[which] < own.values[which] - SAME * self.range[which]:
                level = float(rival.values[which] / self.sizes[which])
                self.designs[which] = self._alone(which, {**rival.solution.decisions, LEVEL: level})
                self.least[which] = self.designs[which].values[which]

    def _alone(self, which: int, start: Start) -> Design:
        compromise = self._wishes.least(which, 1.0 / self.sizes)
        design, reason = self._seeker.sought(compromise, start)
        if design is None:
            name = self._wishes.names[which]
            raise ProblemError(f"trade_off: the best design for '{name}' alone was not found: {reason}")
        factors = (np.arange(len(self.sizes)) == which).astype(float)
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


def check_crowd(problem: Problem) -> None:
    """Raise `ProblemError` for decisions without finite bounds, `MissingExtraError` without the library."""
    load_pymoo('trade_off: method="population"')
    places = problem.placements
    open_ended = ~np.isfinite(places.vector("upper") - places.vector("lower"))
    if open_ended.any():
        names = [name for name, is_open in zip(places.entry_names(), open_ended, strict=True) if is_open]
        raise ProblemError(
            f'trade_off: method="population" draws designs between the bounds of decisions, of which {names[:5]} have '
            'none: give them lower= and upper=, or use method="boundary".'
        )


def crowd(
    wishes: Wishes,
    anchors: Sequence[Design],
    points: int,
    evaluations: int,
    seed: int,
    executor: Executor | None,
    progress: Callable[[int], None],
) -> tuple[list[Member], bool]:
    """Designs of a population spread over the front, at most `points`, as far from one another as can be; and whether
    Ctrl-C ended it, after which they are the best until then.

    - `anchors`: the best designs of the wishes, of its first generation; `progress`: called with the evaluations done.
    """
    transcribed = transcribe(wishes.unscaled().problem, DEFAULT)
    program, places = valued_by(executor, transcribed.program, "trade_off"), transcribed.places
    is_free = np.array([name != LEVEL for name in places.entry_names()])
    rows = wishes.rows(transcribed)
    seen: list[tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k wishes"]]] = []

    def whole(free: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k all"]:
        every = np.repeat(program.start[None], len(free), axis=0)
        every[:, is_free] = free
        return every

    def values(free: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        assert program.values is not None
        _, constraints = program.values(whole(free))
        reached, violations = constraints[:, rows], _violations(program, constraints)
        held = violations <= _HELD
        seen.append((free[held], reached[held]))
        return reached, violations

    first = np.array([places.moved(program.start, without_level(one.solution.decisions)) for one in anchors])
    interrupted = False
    try:
        with answering() as answer:

            def heed(done: int) -> None:
                progress(done)
                answer()

            found = population_front(
                values,
                program.lower[is_free],
                program.upper[is_free],
                first[:, is_free],
                points=points,
                evaluations=evaluations,
                seed=seed,
                heed=heed,
            )
            reached = values(found)[0]
    except KeyboardInterrupt:
        if not seen:
            raise
        interrupted = True
        found, reached = (np.concatenate(part) for part in zip(*seen, strict=True))
        kept = efficient(reached, np.zeros(reached.shape[1]))
        found, reached = found[kept], reached[kept]
    # The anchors are on the front already.
    known = np.array([one.values for one in anchors])
    chosen = far_apart(np.concatenate([known, reached]), points, taken=len(known))
    members = [Member(reached[i], places.named(whole(found[i : i + 1])[0])) for i in np.array(chosen, int) - len(known)]
    return members, interrupted


def _violations(program: NonlinearProgram, constraints: Float[np.ndarray, "k m"]) -> Float[np.ndarray, " k"]:
    """The largest violation of each design, over the magnitudes of the constraints."""
    beyond = np.fmax(constraints - program.constraint_upper, program.constraint_lower - constraints)
    worst = np.max(beyond / program.constraint_scale, axis=1, initial=0.0)
    return np.where(np.isfinite(constraints).all(axis=1), worst, np.inf)
