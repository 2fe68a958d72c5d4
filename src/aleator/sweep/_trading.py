"""`trade_off`: a front in the making, with the problems that lead to further points and what is told of those found."""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from typing import Any, Literal, TypeAlias, assert_never, final, get_args

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, a_name, one_of, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver
from aleator.sweep._runner import Runner, running
from aleator.sweep._seeking import SAME, Anchors, Member, Seeker, between, check_crowd, crowd
from aleator.sweep._trade_off import Gap, TradeOff, box, efficient, simplex
from aleator.sweep._wishes import Compromise, Design, Wishes, refuse_own_names
from aleator.transcription import DEFAULT, AbstractTranscription

Method: TypeAlias = Literal["boundary", "limits", "weights", "population"]

# A gap of the front is a hole if lines between its ends, down to this part of the whole, end upon them.
_NARROWEST = 1e-3
# Anchors whose differences span less than this part of their range in some direction lie on no simplex.
_FLAT = 1e-3
# So many lines at most, for each point asked for, where lines may pass by the front.
_LINES = 3


@final
class FrontInTheMaking:
    """A front in the making; `done` counts the points sought so far."""

    def __init__(self, wishes: Wishes, seeker: Seeker, points: int):
        self._wishes, self._seeker, self._points = wishes, seeker, points
        self.anchors = Anchors(wishes, seeker)
        self._further, self._crowd = list[Design](), list[Member]()
        self._failed: list[str] = []
        self._holes: list[tuple[float, float]] = []
        self.done = 0

    @property
    def _designs(self) -> list[Design]:
        return [*self.anchors.designs, *self._further]

    @property
    def _best(self) -> Float[np.ndarray, " wishes"]:
        return np.minimum(self.anchors.values.min(axis=0), self.anchors.least)

    def spread(self, evaluations: int, seed: int, executor: Executor | None, run: Runner) -> None:
        """Let a population spread over the front."""
        anchors = self.anchors.designs
        self._crowd, run.interrupted = crowd(
            self._wishes,
            anchors,
            self._points - len(anchors),
            evaluations,
            seed,
            executor,
            lambda done: run.progress("population", done, evaluations),
        )

    def problems(self, method: Method) -> Iterator[Compromise]:
        """The problems of further points, each chosen by what has been found before."""
        if self.anchors.constant.all():
            return
        scales, count = self.anchors.scales, self._points - len(self.anchors.designs)
        if method == "weights":
            yield from (self._wishes.weighted(one, scales) for one in simplex(len(scales), count))
        elif method == "limits":
            yield from self._limited(scales, count)
        elif method == "boundary":
            yield from self._along(scales, count)
        elif method == "population":
            yield from (self._wishes.along(one.values, scales) for one in self._crowd)
        else:
            assert_never(method)

    def add(self, compromise: Compromise) -> None:
        """Solve one of these problems, from the nearest design; again from others if it ends at a known one."""
        designs = self._designs
        values = [*(one.values for one in designs), *(one.values for one in self._crowd)]
        starts = [*(one.solution for one in designs), *(one.decisions for one in self._crowd)]
        start = starts[np.argmin([compromise.distance(one) for one in values])]
        design, reason = self._seeker.sought(compromise, start)
        self.done += 1
        if design is None:
            self._failed.append(reason)
            return
        self._further.append(design)
        if self._seeker.starts > 1 or not self._is_known(design, designs):
            return
        # Where a slope vanishes, a known design may be stationary on the way to others.
        for other in self._around(compromise, designs):
            again, _ = self._seeker.sought(compromise, other)
            if again is not None and again.solution.objective < design.solution.objective - SAME:
                self._further[-1] = again
                return

    def _is_known(self, design: Design, others: list[Design]) -> bool:
        near = SAME / self.anchors.scales
        return any((np.abs(design.values - one.values) <= near).all() for one in others)

    def _around(self, compromise: Compromise, designs: list[Design]) -> Iterator[Mapping[str, Any] | None]:
        """Starts elsewhere: between the nearest designs to all sides of a place, and the problem's own."""
        nearest: dict[tuple[int, bool], Design] = {}
        for one in sorted(designs, key=lambda one: compromise.distance(one.values)):
            away = compromise.away(one.values)
            which = int(np.argmax(np.abs(away)))
            nearest.setdefault((which, bool(away[which] > 0)), one)
        middle = between([one.solution for one in nearest.values()]) if len(nearest) > 1 else None
        if middle is not None:
            yield middle
        yield None

    def _limited(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Limits on all wishes but the first, on a grid over their ranges."""
        others = len(scales) - 1
        each = max(round(count ** (1 / others)), 1)
        parts = np.arange(1, each + 1) / (each + 1)
        for at in np.stack(np.meshgrid(*[parts] * others), axis=-1).reshape(-1, others):
            yield self._wishes.within(0, self._best + np.append(0.0, at) * self.anchors.range, scales)

    def _along(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Lines from between the anchors; for two wishes, in the middle of the largest gap."""
        corners = self.anchors.values
        if len(corners) == 2:
            yield from self._bisected(scales, count)
        elif np.linalg.svd((corners[1:] - corners[0]) * scales)[1][-1] > _FLAT:
            yield from (self._wishes.along(one @ corners, scales) for one in simplex(len(corners), count))
        else:
            yield from self._across(scales, count)

    def _across(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Lines through all of the box between best and worst, ever more, until enough of them end at designs."""
        lines, parts, seen = 0, 1, set[tuple[float, ...]]()
        while lines < _LINES * count and len(self._distinct()) < self._points:
            parts += 1
            for one in box(len(scales), parts):
                place = tuple(np.round(one, 9))
                if place in seen or lines >= _LINES * count or len(self._distinct()) >= self._points:
                    continue
                seen.add(place)
                lines += 1
                yield self._wishes.along(self._best + one * self.anchors.range, scales)

    def _bisected(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        corners, found = self.anchors.values, self._further
        gaps = [Gap(0.0, 1.0, *corners)]
        for _ in range(count):
            self._holes += [one.ends for one in gaps if one.width <= _NARROWEST and one.size(scales) > 10 * _NARROWEST]
            gaps = [one for one in gaps if one.width > _NARROWEST]
            if not gaps:
                return
            widest = max(gaps, key=lambda one: one.size(scales))
            gaps.remove(widest)
            middle, known = (widest.first + widest.last) / 2, len(found)
            yield self._wishes.along(corners[0] + middle * (corners[1] - corners[0]), scales)
            if len(found) > known:
                point = found[-1].values
                halves = (
                    Gap(widest.first, middle, widest.before, point),
                    Gap(middle, widest.last, point, widest.after),
                )
                gaps += [one for one in halves if one.size(scales) > SAME]

    def _distinct(self) -> list[int]:
        """The efficient designs that differ from one another, in the order of the first wish."""
        values, near = np.array([one.values for one in self._designs]), SAME / self.anchors.scales
        kept = efficient(values, near)
        distinct: list[int] = []
        for i in np.argsort(values[:, 0], kind="stable"):
            if kept[i] and all((np.abs(values[i] - values[j]) > 10 * near).any() for j in distinct):
                distinct.append(int(i))
        return distinct

    def told(self, interrupted: bool) -> TradeOff:
        """The efficient designs in order."""
        designs, distinct = self._designs, self._distinct()
        values, count = np.array([one.values for one in designs]), len(self._wishes.names)
        dominated = int((~efficient(values, SAME / self.anchors.scales)).sum())
        is_sought = np.arange(count) < len(self.anchors.designs)
        chosen = [designs[i] for i in distinct]
        return TradeOff(
            names=self._wishes.names,
            wishes=self._wishes.expressions,
            values=values[distinct],
            solutions=tuple(self._wishes.told(one) for one in chosen),
            best=np.where(is_sought, np.minimum(values.min(axis=0), self.anchors.least), np.nan),
            worst=self.anchors.values.max(axis=0),
            weights=np.array([one.weights for one in chosen]),
            asked=self._points,
            dominated=dominated,
            repeated=len(designs) - len(distinct) - dominated,
            holes=self._told_holes(values[distinct][:, 0]),
            failed=tuple(self._failed),
            interrupted=interrupted,
        )

    def _told_holes(self, first: Float[np.ndarray, " points"]) -> tuple[tuple[float, float], ...]:
        """The holes, from one design that is told to the next: a line through one may end at a dominated design."""
        told = set[tuple[float, float]]()
        for low, high in self._holes:
            before = int(np.searchsorted(first, (low + high) / 2)) - 1
            if 0 <= before < len(first) - 1:
                told.add((float(first[before]), float(first[before + 1])))
        return tuple(sorted(told))


def trade_off(
    problem: Problem,
    wishes: Mapping[str, Expression],
    points: int = 15,
    *,
    method: Method = "boundary",
    starts: int = 1,
    evaluations: int = 5000,
    seed: int = 0,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> TradeOff:
    """Find designs of which none is better in one wish without being worse in another.

    - `problem`: its model and its constraints; its own objective does not count, nor penalties in it (`al.soft`);
    - `wishes`: expressions to be small, by name, two or more (use `-x` for a large one); `points`: designs to look for,
      the best ones of the wishes included. There are fewer where some turn out to be the same, as `print` tells, and
      about so many by `"limits"` with three wishes or more, whose values form a grid;
    - `method`: how points are chosen. `"boundary"`: along parallel lines from between the best designs of each wish
      towards better ones (normal boundary intersection, Das and Dennis 1998, in the form of Pascoletti and Serafini
      1984), where fronts may be concave; for two wishes the largest gaps are filled, until they are proven holes. For
      three or more, parts of the front that lie beyond the best designs are not reached, unless these coincide: lines
      then cross the whole box between best and worst.
      `"limits"`: the first wish, with limits on the others (Haimes et al. 1971), two wishes or more. `"weights"`:
      weighted sums, which find convex parts of a front alone. `"population"`: a population spreads over the whole front
      (NSGA-II, Deb et al. 2002, of the extra `fronts`), for fronts in parts and designs in many basins; its designs are
      starts of lines through them, which lead to the front itself. A small share of all wishes in every objective keeps
      designs away at which a wish could be better at no cost (Mavrotas 2009);
    - `solver`, `transcription`: those of `al.solve`, which certifies every point. Each point starts from its nearest
      neighbour, from the problem's own start where that fails, and then by `al.solvers.Slsqp()` unless a solver is
      given. One that ends at a known design is sought again from between its neighbours;
    - `starts`: local searches for each point, all but one from random starts, for problems with several optima, whose
      fronts may be in parts; the best designs of the wishes are then searched for globally (see `al.portfolio`);
    - `evaluations`, `seed`: of a population: simulated designs, and its random numbers;
    - `executor`: simulates the generations of a population, and does the local searches of `starts` at once (see
      `al.pareto`), with the same front.

    At the best design of a wish, the others are improved as far as they can be without making it worse (lexicographic
    order). Everything is compiled once. Ctrl-C returns the points found so far; in a population it ends that, whose
    designs until then lead to points, and a second one ends these. Raises `ProblemError` for fewer than two wishes, for
    one that no decision changes, if the best design of some wish cannot be found, for a problem without decisions or
    with a limit whose price (`al.soft` with `exact=True`) would not count, and for decisions without bounds if a
    population is asked for.
    """
    one_of("trade_off: problem", problem, Problem)
    names = _names(wishes)
    points = whole("trade_off: points", points, least=len(names))
    starts = whole("trade_off: starts", starts)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary", "limits", "weights" or "population"', method)
    evaluations, seed = whole("trade_off: evaluations", evaluations), whole("trade_off: seed", seed, least=0)
    if executor is not None and method != "population" and starts == 1:
        raise ProblemError(
            'trade_off: executor: expected method="population" or starts= of at least 2, whose simulations or searches '
            f"can be shared; received method={method!r} with one start, where each design follows from those before."
        )
    if method == "population":
        check_crowd(problem)
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    _check_problem(problem, wishes)
    front = FrontInTheMaking(Wishes(problem, wishes), Seeker(transcription, solver, starts, executor), points)
    with running("trade_off", lambda: front.anchors.designs, progress, executor) as run:
        front.anchors.find(run)
        if method == "population":
            front.spread(evaluations, seed, executor, run)
        for one in front.problems(method):
            with run.step("trade-off", front.done, points, f"point {front.done + 1}"):
                front.add(one)
    return front.told(run.interrupted)


def _names(wishes: Mapping[str, Expression]) -> tuple[str, ...]:
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal(
            "trade_off: wishes", "two expressions or more by name, such as {'ride': ..., 'cost': ...}", wishes
        )
    for name, one in wishes.items():
        if not a_name("trade_off: the name of a wish", name).isprintable():
            raise refusal("trade_off: the name of a wish", "a name of one line", name)
        one_of(f"trade_off: wish '{name}'", one, Expression)
    return tuple(wishes)


def _check_problem(problem: Problem, wishes: Mapping[str, Expression]) -> None:
    """Refuse problems without decisions, with names that are needed here, or with prices that would not count."""
    decisions = problem.placements.decisions
    if not decisions:
        raise ProblemError(
            "trade_off: the problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number."
        )
    refuse_own_names(problem)
    for name in problem.names:
        excess = f"{name}.excess"
        if excess in decisions and not any(excess in str(one) for one in wishes.values()):
            raise ProblemError(
                f"trade_off: problem: the price of the soft limit '{name}' is in the objective, which does not count "
                f"here, so that nothing would hold it: add al.value('{excess}') to a wish, or give the problem before "
                "al.soft."
            )
