"""The search for a front of several wishes: first its anchors, which are the best designs of each wish, at which the
others are as good as they can be without making it worse; then further points, each chosen by those before.
"""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator.nlp import AbstractSolver, DifferentialEvolution, Slsqp, variable_range
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._portfolio import portfolio
from aleator.sweep._runner import Runner, finished
from aleator.sweep._trade_off import TradeOff, box, efficient, simplex
from aleator.sweep._wishes import LEVEL, Compromise, Design, Wishes
from aleator.transcription import AbstractTranscription, transcribe

Method: TypeAlias = Literal["boundary", "limits", "weights", "population"]
Start: TypeAlias = Solution | Mapping[str, Any] | None

# A wish of a smaller range, as a part of its magnitude, is constant; an improvement by less of the range is none.
_CONSTANT, _SAME = 1e-9, 1e-5
# What a wish may give up, as a part of its range, while the others are improved. An improvement that is not many times
# what the price of the wish makes of that has been bought by it.
_GIVEN_UP, _BOUGHT, _STEEPER = 1e-7, 20.0, 1.1
# Slopes of this part of a wish's magnitude, over the range of a decision, are rounding; random points to look at.
_STILL, _POINTS = 1e-12, 4
# A gap of the front is a hole if lines between its ends, down to this part of the whole, end upon them.
_NARROWEST = 1e-3
# Anchors whose differences span less than this part of their range in some direction lie on no simplex.
_FLAT = 1e-3
# So many lines at most, for each point asked for, where lines may pass by the front.
_LINES = 3


class Member(NamedTuple):
    """A design of a population: its wishes, in their own units, and its decisions by name."""

    values: Float[np.ndarray, " wishes"]
    decisions: Mapping[str, Any]


class Gap(NamedTuple):
    """A gap of a front of two wishes: its places on the line between the anchors, from 0 to 1, and the points there."""

    first: float
    last: float
    before: Float[np.ndarray, " wishes"]
    after: Float[np.ndarray, " wishes"]


@final
@dataclass(eq=False)
class Search:
    """A search for a front of so many `points`, by solves as the other arguments of `trade_off` tell.

    - `designs`: those found, the anchors first, in the order of the wishes;
    - `crowd`: a population, from whose designs lines lead to the front.
    """

    wishes: Wishes
    points: int
    transcription: AbstractTranscription
    solver: AbstractSolver | None
    starts: int
    executor: Executor | None
    designs: list[Design] = field(default_factory=list)
    crowd: list[Member] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._count = len(self.wishes.names)
        self._least = np.full(self._count, np.inf)  # of each wish alone
        self._failed: list[str] = []
        self._holes: list[Gap] = []

    # --- Solves ------------------------------------------------------------------------------------------------------

    def _sought(self, compromise: Compromise, start: Start) -> tuple[Design | None, str]:
        """The design of a compromise; or None, and why."""
        solution = self._solved(compromise, start)
        if self.starts > 1:
            own = {"solver": self.solver, "executor": self.executor}
            other = portfolio(compromise.problem, self.starts, search=None, **own).best
            solution = min((solution, other), key=lambda one: (not one.ok, one.objective))
        return (self.wishes.design(compromise, solution), "") if solution.ok else (None, solution.why())

    def _solved(self, compromise: Compromise, start: Start) -> Solution:
        """The first solution from a start, from the problem's own, and by SLSQP, which makes ever longer steps where
        wishes are linear, as others do not; the last one if none is solved.
        """
        tries = [(self.solver, start)]
        tries += [] if start is None else [(self.solver, None)]
        tries += [] if self.solver else [(Slsqp(), start)]
        solution = None
        for solver, begun in tries:
            design = {"warm_start": begun} if isinstance(begun, Solution) else {"start": begun}
            own = {"transcription": self.transcription, "throw": False}
            solution = finished(solve(compromise.problem, solver, **design, **own))
            if solution.ok:
                break
        assert solution is not None
        return solution

    # --- Anchors -----------------------------------------------------------------------------------------------------

    @property
    def _corners(self) -> Float[np.ndarray, "anchors wishes"]:
        """The wishes at the anchors, in their own units."""
        return np.array([one.values for one in self.designs[: self._count]])

    @property
    def _range(self) -> Float[np.ndarray, " wishes"]:
        return np.ptp(self._corners, axis=0)

    @property
    def _magnitudes(self) -> Float[np.ndarray, " wishes"]:
        return np.maximum(np.abs(self._corners).max(axis=0), self._sizes)

    @property
    def _constant(self) -> Bool[np.ndarray, " wishes"]:
        """Which wishes differ at the anchors by rounding alone."""
        return self._range <= _CONSTANT * self._magnitudes

    @property
    def _scales(self) -> Float[np.ndarray, " wishes"]:
        """By which wishes are multiplied: over their ranges, or their magnitudes where they are constant."""
        return 1.0 / np.where(self._constant, self._magnitudes, self._range)

    def find_anchors(self, run: Runner) -> None:
        """Find each wish's best design alone; then improve the others while it is held (lexicographic order)."""
        self._measure()
        task, count = "best of each wish", self._count
        for which in range(count):
            with run.step(task, which, count, task):
                self.designs.append(self._alone(which, self._everywhere(which)))
        with run.step(task, count, count, task):
            self._settle_rivals()
        scales = self._scales
        for which in range(count if not self._constant.all() else 0):
            with run.step(task, which, count, task):
                self.designs[which] = self._improved(which, scales)

    def _measure(self) -> None:
        """The magnitudes of the wishes around the problem's start. Refuses wishes that nothing changes."""
        transcribed = transcribe(self.wishes.compromise(np.ones(self._count)).problem, self.transcription)
        first = len(transcribed.problem.constraints) - self._count - 1
        sizes = np.array(transcribed.scales[first : first + self._count])
        self._sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
        program, rows = transcribed.program, self.wishes.rows(transcribed)
        if program.start.size != transcribed.problem.placements.size:
            return  # States that are variables change whatever depends on them.
        lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
        drawn = np.random.default_rng(0).uniform(lower, upper, (_POINTS, program.start.size))
        slopes = [program.evaluate(one).jacobian[rows] * program.variable_scale for one in (program.start, *drawn)]
        still = (np.abs(slopes) <= _STILL * self._sizes[:, None]).all(axis=(0, 2))
        if still.any():
            name = self.wishes.names[int(np.argmax(still))]
            raise ProblemError(f"trade_off: wish '{name}': no decision changes it; leave it out.")

    def _everywhere(self, which: int) -> Start:
        """Where a wish is least everywhere, as far as a global search tells; None if none is asked for."""
        if self.starts == 1:
            return None
        problem = self.wishes.only(which)
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        own = {"solver": self.solver, "executor": self.executor}
        return portfolio(problem, self.starts, search=search, **own).best.decisions

    def _settle_rivals(self) -> None:
        """Where another's design is better in a wish than its own, which ended at a worse optimum or on a plateau, seek
        it again from there.
        """
        for which, own in enumerate(self.designs):
            rival = self.designs[int(np.argmin(self._corners[:, which]))]
            if rival.values[which] < own.values[which] - _SAME * self._range[which]:
                level = float(rival.values[which] / self._sizes[which])
                self.designs[which] = self._alone(which, {**rival.solution.decisions, LEVEL: level})

    def _alone(self, which: int, start: Start) -> Design:
        """The best design of a wish, whatever becomes of the others."""
        own = np.eye(self._count)[which]
        offsets = np.where(own, 0.0, np.inf)
        alone = self.wishes.compromise(1.0 / self._sizes, offsets=offsets, directions=own, share=0.0)
        design, reason = self._sought(alone, start)
        if design is None:
            name = self.wishes.names[which]
            raise ProblemError(f"trade_off: the best design for '{name}' alone was not found: {reason}")
        self._least[which] = design.values[which]
        return design._replace(weights=np.full(self._count, np.nan), factors=own)

    def _improved(self, which: int, scales: Float[np.ndarray, " wishes"]) -> Design:
        """The best design of a wish after the others were improved while it is held, with the prices there."""
        alone = self.designs[which]
        others = np.arange(self._count) != which
        most = np.where(others, np.inf, scales * alone.values + _GIVEN_UP)
        held = self.wishes.compromise(scales, offsets=most, weights=others.astype(float), share=0.0)
        start = {**alone.solution.decisions, LEVEL: float((scales * alone.values)[others].sum())}
        design, _ = self._sought(held, start)
        if design is None:
            return alone
        better = float((scales * (alone.values - design.values))[others].sum())
        bought = design.weights[which] / scales[which] * _GIVEN_UP
        if better > max(_SAME, _BOUGHT * bought):
            return design
        # Where much more was bought than by a constant price, the front is ever steeper towards its end.
        return alone if better > max(_SAME, _STEEPER * bought) else alone._replace(weights=design.weights)

    # --- Further points ----------------------------------------------------------------------------------------------

    def find_further(self, run: Runner, method: Method) -> None:
        """Solve the problems of further points, until there are as many as were asked for."""
        for done, compromise in enumerate(self._problems(method)):
            with run.step("trade-off", done, self.points, f"point {done + 1}"):
                self._add(compromise)

    def _problems(self, method: Method) -> Iterator[Compromise]:
        """The problems of further points, each chosen by what has been found before."""
        compromise, corners, scales = self.wishes.compromise, self._corners, self._scales
        count = self.points - self._count
        best = np.minimum(corners.min(axis=0), self._least)
        if self._constant.all():
            return
        if method == "weights":
            yield from (compromise(scales, weights=one) for one in simplex(self._count, count))
        elif method == "limits":
            # On all wishes but the first, which is to be small, on a grid over their ranges.
            others = self._count - 1
            each = max(round(count ** (1 / others)), 1)
            parts = np.arange(1, each + 1) / (each + 1)
            for at in np.stack(np.meshgrid(*[parts] * others), axis=-1).reshape(-1, others):
                limits = scales * (best + np.append(0.0, at) * self._range)
                own = np.eye(self._count)[0]
                yield compromise(scales, offsets=np.where(own, 0.0, limits), directions=own)
        elif method == "population":
            yield from (self._along(one.values) for one in self.crowd)
        elif self._count == 2:
            yield from self._bisected(count)
        elif np.linalg.svd((corners[1:] - corners[0]) * scales)[1][-1] > _FLAT:
            yield from (self._along(one @ corners) for one in simplex(self._count, count))
        else:
            for one in box(self._count, _LINES * count):
                if len(self._distinct()) < self.points:
                    yield self._along(best + one * self._range)

    def _along(self, start: Float[np.ndarray, " wishes"]) -> Compromise:
        """The last point of a line through `start`, in the wishes' own units, on which all get better alike."""
        return self.wishes.compromise(self._scales, offsets=self._scales * start, directions=1.0)

    def _bisected(self, count: int) -> Iterator[Compromise]:
        """Lines from between the anchors of two wishes, each in the middle of the largest gap."""
        (first, last), scales = self._corners, self._scales
        gaps = [Gap(0.0, 1.0, first, last)]

        def size(gap: Gap) -> float:
            return float(np.abs((gap.after - gap.before) * scales).max())

        for _ in range(count):
            narrow = [gap for gap in gaps if gap.last - gap.first <= _NARROWEST]
            # Lines through a hole end at one of its ends.
            self._holes += [gap for gap in narrow if size(gap) > 10 * _NARROWEST]
            gaps = sorted((gap for gap in gaps if gap.last - gap.first > _NARROWEST), key=size)
            if not gaps:
                return
            widest, known = gaps.pop(), len(self.designs)
            middle = (widest.first + widest.last) / 2
            yield self._along(first + middle * (last - first))
            if len(self.designs) > known:
                point = self.designs[-1].values
                halves = widest._replace(last=middle, after=point), widest._replace(first=middle, before=point)
                gaps += [one for one in halves if size(one) > _SAME]

    def _add(self, compromise: Compromise) -> None:
        """Solve one of these problems, from the nearest design; again from others if it ends at a known one."""
        known = list(self.designs)
        starts = [(one.values, one.solution) for one in known] + [(one.values, one.decisions) for one in self.crowd]
        design, reason = self._sought(compromise, min(starts, key=lambda one: compromise.distance(one[0]))[1])
        if design is None:
            self._failed.append(reason)
            return
        self.designs.append(design)
        near = _SAME / self._scales
        if self.starts > 1 or not any((np.abs(design.values - one.values) <= near).all() for one in known):
            return
        # Where a slope vanishes, a known design may be stationary on the way to others.
        for other in self._around(compromise, known):
            again, _ = self._sought(compromise, other)
            if again is not None and again.solution.objective < design.solution.objective - _SAME:
                self.designs[-1] = again
                return

    def _around(self, compromise: Compromise, designs: list[Design]) -> Iterator[Mapping[str, Any] | None]:
        """Starts elsewhere: between the nearest designs to all sides of a place, and the problem's own."""
        nearest: dict[tuple[int, bool], Mapping[str, Any]] = {}
        for one in sorted(designs, key=lambda one: compromise.distance(one.values)):
            away = compromise.away(one.values)
            which = int(np.argmax(np.abs(away)))
            nearest.setdefault((which, bool(away[which] > 0)), one.solution.decisions)
        first, *others = nearest.values()
        # Decisions that follow a finer mesh in one of them have no mean.
        if others and all(np.shape(one[name]) == np.shape(first[name]) for one in others for name in first):
            yield {name: np.mean([one[name] for one in nearest.values()], axis=0)[()] for name in first}
        yield None

    # --- The front ---------------------------------------------------------------------------------------------------

    def _distinct(self) -> list[int]:
        """The efficient designs that differ from one another, in the order of the first wish."""
        values, near = np.array([one.values for one in self.designs]), _SAME / self._scales
        is_efficient = efficient(values, near)
        distinct: list[int] = []
        for i in np.argsort(values[:, 0], kind="stable"):
            if is_efficient[i] and all((np.abs(values[i] - values[j]) > 10 * near).any() for j in distinct):
                distinct.append(int(i))
        return distinct

    def result(self, interrupted: bool) -> TradeOff:
        """The efficient designs in order."""
        distinct, values = self._distinct(), np.array([one.values for one in self.designs])
        dominated = int((~efficient(values, _SAME / self._scales)).sum())
        is_sought = np.arange(self._count) < len(self.designs)
        # A hole reaches from one efficient design to the next: a line through it may end at a dominated design.
        first = values[distinct][:, 0]
        after = {int(np.searchsorted(first, (one.before[0] + one.after[0]) / 2)) for one in self._holes}
        return TradeOff(
            names=self.wishes.names,
            wishes=self.wishes.expressions,
            values=values[distinct],
            solutions=tuple(self.wishes.solution_of(self.designs[i]) for i in distinct),
            best=np.where(is_sought, np.minimum(values.min(axis=0), self._least), np.nan),
            worst=self._corners.max(axis=0),
            weights=np.array([self.designs[i].weights for i in distinct]),
            asked=self.points,
            dominated=dominated,
            repeated=len(self.designs) - len(distinct) - dominated,
            holes=tuple((float(first[i - 1]), float(first[i])) for i in sorted(after) if 0 < i < len(first)),
            failed=tuple(self._failed),
            interrupted=interrupted,
        )
