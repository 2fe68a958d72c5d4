"""`trade_off`: a front in the making, with the problems that lead to further points and what is told of those found."""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from typing import Any, Literal, TypeAlias, final, get_args

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, a_name, one_of, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver, load_pymoo
from aleator.sweep._runner import running
from aleator.sweep._seeking import SAME, Anchors, Member, Seeker, crowd
from aleator.sweep._trade_off import TradeOff, box, efficient, simplex
from aleator.sweep._wishes import Compromise, Design, Wishes
from aleator.transcription import DEFAULT, AbstractTranscription

Method: TypeAlias = Literal["boundary", "limits", "weights", "population"]

# A gap of the front is a hole if lines between its ends, down to this part of the whole, end upon them.
_NARROWEST = 1e-3
# Anchors whose differences span less than this part of their range in some direction lie on no simplex.
_FLAT = 1e-3
# So many lines at most, for each point asked for, where lines may pass by the front.
_LINES = 3


@final
class _FrontInTheMaking:
    """A front in the making.

    - `anchors`: the best designs of the wishes; `crowd`: designs of a population, from which lines lead to the front;
    - `done`: counts the points sought so far.
    """

    def __init__(self, wishes: Wishes, seeker: Seeker, points: int):
        self._wishes, self._seeker, self._points = wishes, seeker, points
        self.anchors, self.crowd = Anchors(wishes, seeker), list[Member]()
        self._further = list[Design]()
        self._failed: list[str] = []
        self._holes: list[tuple[float, float]] = []
        self.done = 0

    @property
    def _designs(self) -> list[Design]:
        return [*self.anchors.designs, *self._further]

    @property
    def _best(self) -> Float[np.ndarray, " wishes"]:
        return np.minimum(self.anchors.values.min(axis=0), self.anchors.least)

    def problems(self, method: Method) -> Iterator[Compromise]:
        """The problems of further points, each chosen by what has been found before."""
        if self.anchors.constant.all():
            return
        wishes, corners, scales = self._wishes, self.anchors.values, self.anchors.scales
        size, count = len(scales), self._points - len(corners)
        if method == "weights":
            yield from (wishes.weighted(one, scales) for one in simplex(size, count))
        elif method == "limits":
            yield from self._limited(scales, count)
        elif method == "population":
            yield from (wishes.along(one.values, scales) for one in self.crowd)
        elif size == 2:
            yield from self._bisected(scales, count)
        elif np.linalg.svd((corners[1:] - corners[0]) * scales)[1][-1] > _FLAT:
            yield from (wishes.along(one @ corners, scales) for one in simplex(size, count))
        else:
            for one in box(size, _LINES * count):
                if len(self._distinct()) < self._points:
                    yield wishes.along(self._best + one * self.anchors.range, scales)

    def add(self, compromise: Compromise) -> None:
        """Solve one of these problems, from the nearest design; again from others if it ends at a known one."""
        designs = self._designs
        starts = [(one.values, one.solution) for one in designs] + [(one.values, one.decisions) for one in self.crowd]
        design, reason = self._seeker.sought(compromise, min(starts, key=lambda one: compromise.distance(one[0]))[1])
        self.done += 1
        if design is None:
            self._failed.append(reason)
            return
        self._further.append(design)
        near = SAME / self.anchors.scales
        is_known = any((np.abs(design.values - one.values) <= near).all() for one in designs)
        if self._seeker.starts > 1 or not is_known:
            return
        # Where a slope vanishes, a known design may be stationary on the way to others.
        for other in self._around(compromise, designs):
            again, _ = self._seeker.sought(compromise, other)
            if again is not None and again.solution.objective < design.solution.objective - SAME:
                self._further[-1] = again
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

    def _limited(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Limits on all wishes but the first, on a grid over their ranges."""
        others = len(scales) - 1
        each = max(round(count ** (1 / others)), 1)
        parts = np.arange(1, each + 1) / (each + 1)
        for at in np.stack(np.meshgrid(*[parts] * others), axis=-1).reshape(-1, others):
            yield self._wishes.within(0, self._best + np.append(0.0, at) * self.anchors.range, scales)

    def _bisected(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Lines from the line between the anchors of two wishes, each in the middle of the largest gap.

        Gaps are the two places on that line, from 0 to 1, and the points of the front there.
        """
        first, last = self.anchors.values
        gaps = [(0.0, 1.0, first, last)]

        def size(gap: tuple[float, float, np.ndarray, np.ndarray]) -> float:
            return float(np.abs((gap[3] - gap[2]) * scales).max())

        for _ in range(count):
            narrow = [gap for gap in gaps if gap[1] - gap[0] <= _NARROWEST]
            # Lines through a hole end at one of its ends.
            self._holes += [(float(gap[2][0]), float(gap[3][0])) for gap in narrow if size(gap) > 10 * _NARROWEST]
            gaps = [gap for gap in gaps if gap[1] - gap[0] > _NARROWEST]
            if not gaps:
                return
            widest = max(range(len(gaps)), key=lambda i: size(gaps[i]))
            start, end, before, after = gaps.pop(widest)
            middle, known = (start + end) / 2, len(self._further)
            yield self._wishes.along(first + middle * (last - first), scales)
            if len(self._further) > known:
                point = self._further[-1].values
                halves = (start, middle, before, point), (middle, end, point, after)
                gaps += [gap for gap in halves if size(gap) > SAME]

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
        # A hole reaches from one design that is told to the next: a line through it may end at a dominated design.
        first = values[distinct][:, 0]
        after = {int(np.searchsorted(first, (low + high) / 2)) for low, high in self._holes}
        return TradeOff(
            names=self._wishes.names,
            wishes=self._wishes.expressions,
            values=values[distinct],
            solutions=tuple(self._wishes.told(designs[i]) for i in distinct),
            best=np.where(is_sought, np.minimum(values.min(axis=0), self.anchors.least), np.nan),
            worst=self.anchors.values.max(axis=0),
            weights=np.array([designs[i].weights for i in distinct]),
            asked=self._points,
            dominated=dominated,
            repeated=len(designs) - len(distinct) - dominated,
            holes=tuple((float(first[i - 1]), float(first[i])) for i in sorted(after) if 0 < i < len(first)),
            failed=tuple(self._failed),
            interrupted=interrupted,
        )


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
    one that no decision changes, if the best design of some wish cannot be found, for a limit whose price (`al.soft`
    with `exact=True`) would not count, and for decisions without bounds if a population is asked for. Names of
    constraints that begin with `trade-off` are its own.
    """
    one_of("trade_off: problem", problem, Problem)
    _check_wishes(problem, wishes)
    points = whole("trade_off: points", points, least=len(wishes))
    starts = whole("trade_off: starts", starts)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary", "limits", "weights" or "population"', method)
    evaluations, seed = whole("trade_off: evaluations", evaluations), whole("trade_off: seed", seed, least=0)
    if method == "population":
        _check_population(problem)
    elif executor is not None and starts == 1:
        raise ProblemError(
            'trade_off: executor: expected method="population" or starts= of at least 2, whose simulations or searches '
            f"can be shared; received method={method!r} with one start, where each design follows from those before."
        )
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    every = Wishes(problem, wishes)
    making = _FrontInTheMaking(every, Seeker(transcription, solver, starts, executor), points)
    anchors = making.anchors
    with running("trade_off", lambda: anchors.designs, progress, executor) as run:
        anchors.find(run)
        if method == "population":
            making.crowd = crowd(every, anchors.designs, points - len(wishes), evaluations, seed, run)
        for one in making.problems(method):
            with run.step("trade-off", making.done, points, f"point {making.done + 1}"):
                making.add(one)
    return making.told(run.interrupted)


def _check_wishes(problem: Problem, wishes: Mapping[str, Expression]) -> None:
    """Refuse what are no wishes by name, and prices in the problem's objective, which would not count."""
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal(
            "trade_off: wishes", "two expressions or more by name, such as {'ride': ..., 'cost': ...}", wishes
        )
    for name, one in wishes.items():
        if not a_name("trade_off: the name of a wish", name).isprintable():
            raise refusal("trade_off: the name of a wish", "a name of one line", name)
        one_of(f"trade_off: wish '{name}'", one, Expression)
    for name in problem.names:
        excess = f"{name}.excess"
        if excess in problem.placements.decisions and not any(excess in str(one) for one in wishes.values()):
            raise ProblemError(
                f"trade_off: problem: the price of the soft limit '{name}' is in the objective, which does not count "
                f"here, so that nothing would hold it: add al.value('{excess}') to a wish, or give the problem before "
                "al.soft."
            )


def _check_population(problem: Problem) -> None:
    """Raise `ProblemError` for decisions without finite bounds, `MissingExtraError` without the library."""
    load_pymoo('trade_off: method="population"')
    places = problem.placements
    is_open = ~np.isfinite(places.vector("upper") - places.vector("lower"))
    if is_open.any():
        name = places.entry_names()[int(np.argmax(is_open))]
        raise ProblemError(
            f"trade_off: method=\"population\" draws designs between the bounds of decisions, of which '{name}' has "
            'none: give it lower= and upper=, or use method="boundary".'
        )
