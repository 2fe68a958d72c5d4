"""`trade_off`: designs of which none is better in all wishes, and how their front is found."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, TypeAlias, final, get_args

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator._core.given import a_name, one_of, refusal, whole
from aleator._core.heard import heeding
from aleator._core.progress import Progress, check_progress, silent
from aleator._core.warned import warned_of
from aleator.design import Expression, Problem, current
from aleator.nlp import AbstractSolver, DifferentialEvolution, Slsqp
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._crowd import Budget, Member, check_crowd, crowd
from aleator.sweep._hypervolume import efficient
from aleator.sweep._places import Gap, simplex
from aleator.sweep._portfolio import portfolio
from aleator.sweep._trade_off import TradeOff
from aleator.sweep._wishes import Compromise, Found, Wishes, pressed
from aleator.transcription import DEFAULT, AbstractTranscription, transcribe

Method = Literal["boundary", "limits", "weights", "population"]
_Start: TypeAlias = Solution | Mapping[str, Any] | None

# Points are equal if no wish differs by more than this part of its range; a wish of a smaller range is constant.
_SAME, _CONSTANT = 1e-5, 1e-9
# A gap of the front is a hole if lines between its ends, down to this part of the whole, end upon them.
_NARROWEST = 1e-3


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
    progress: Progress = silent,
) -> TradeOff:
    """Find designs of which none is better in one wish without being worse in another.

    - `problem`: its model and its constraints; its own objective does not count;
    - `wishes`: expressions to be small, by name, two or more (use `-x` for a large one); `points`: designs in all;
    - `method`: how points are chosen. `"boundary"`: along parallel lines from between the best designs of each wish
      towards better ones (normal boundary intersection, Das and Dennis 1998, in the form of Pascoletti and Serafini
      1984), where fronts may be concave; for two wishes the largest gaps are filled, until they are proven holes.
      `"limits"`: the first wish, with limits on the others (Haimes et al. 1971), two wishes or more. `"weights"`:
      weighted sums, which find convex parts of a front alone. `"population"`: a population spreads over the whole front
      (NSGA-II, Deb et al. 2002, of the extra `fronts`), for fronts in parts and designs in many basins; its designs are
      starts of lines through them, which lead to the front itself. A small share of all wishes in every objective keeps
      designs away at which a wish could be better at no cost (Mavrotas 2009);
    - `solver`, `transcription`: those of `al.solve`, which certifies every point. Each point starts from its nearest
      neighbour, from the problem's own start where that fails, and then by `al.solvers.Slsqp()` unless a solver is
      given;
    - `starts`: local searches for each point, all but one from random starts, for problems with several optima, whose
      fronts may be in parts; the best designs of the wishes are then searched for globally (see `al.portfolio`);
    - `evaluations`, `seed`: of a population: simulated designs, and its random numbers.

    Everything is compiled once. Ctrl-C returns the points found so far. Raises `ProblemError` for fewer than two
    wishes, for one that no decision changes, if the best design of some wish cannot be found, and for decisions without
    bounds if a population is asked for.
    """
    one_of("trade_off: problem", problem, Problem)
    names = _names(wishes)
    points = whole("trade_off: points", points, least=len(names))
    starts = whole("trade_off: starts", starts)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary", "limits", "weights" or "population"', method)
    budget = Budget(whole("trade_off: evaluations", evaluations), whole("trade_off: seed", seed, least=0))
    if method == "population":
        check_crowd(problem)
    check_progress("trade_off", progress)
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    front = _Front(Wishes(current(problem), wishes), transcription, solver, starts)
    interrupted = True
    try:
        with heeding() as heed:
            front.find_anchors(lambda done: progress("best of each wish", done, len(names)), heed)
            if method == "population":
                front.spread(points, budget, lambda done: (progress("population", done, evaluations), heed()))
            for done, one in enumerate(front.problems(method, points)):
                progress("trade-off", done, points)
                front.add(one)
                heed()
        interrupted = False
    except KeyboardInterrupt:
        if len(front.anchors) < len(names):
            raise
    return front.told(interrupted)


def _names(wishes: Mapping[str, Expression]) -> tuple[str, ...]:
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal(
            "trade_off: wishes", "two expressions or more by name, such as {'ride': ..., 'cost': ...}", wishes
        )
    for name, one in wishes.items():
        one_of(f"trade_off: wish '{a_name('trade_off: the name of a wish', name)}'", one, Expression)
    return tuple(wishes)


@final
class _Front:
    """A front in the making; normalised values are 0 at the best and 1 at the worst of the anchors."""

    def __init__(
        self, wishes: Wishes, transcription: AbstractTranscription, solver: AbstractSolver | None, starts: int
    ):
        self._wishes, self._transcription, self._solver, self._starts = wishes, transcription, solver, starts
        self._found, self._sizes = Found(), np.ones(len(wishes.names))
        self.anchors: list[Float[np.ndarray, " wishes"]] = []
        self._crowd: list[Member] = []

    @property
    def _best(self) -> Float[np.ndarray, " wishes"]:
        return np.min(self.anchors, axis=0)

    @property
    def _range(self) -> Float[np.ndarray, " wishes"]:
        return np.max(self.anchors, axis=0) - self._best

    def find_anchors(self, progress: Callable[[int], None], heed: Callable[[], None]) -> None:
        """The best design of each wish, in scales of their ranges over the first ones."""
        count = len(self._wishes.names)
        self._sizes = self._sizes_at_start()
        scales = 1.0 / self._sizes
        for is_last in (False, True):
            found = Found()
            for which in range(count):
                progress(which)
                # Without scales, the others must not count.
                one = self._wishes.least(which, scales, alone=not is_last)
                self._solve(one, found, start=self._found.solutions[which] if is_last else self._global(which))
                if len(found.solutions) <= which:
                    raise ProblemError(
                        f"trade_off: the best design for '{self._wishes.names[which]}' alone was not found: "
                        f"{found.failed[-1]}"
                    )
                heed()
            self._found, values = found, np.array(found.values)
            spread = np.ptp(values, axis=0)
            if (constant := self._is_constant(values)).all():
                break
            scales = 1.0 / np.where(constant, self._sizes, spread)
        self.anchors = list(self._found.values)

    def _is_constant(self, values: Float[np.ndarray, "points wishes"]) -> Bool[np.ndarray, " wishes"]:
        """Which wishes differ by rounding alone, beside their values and their sizes at the start."""
        return np.ptp(values, axis=0) <= _CONSTANT * np.maximum(np.abs(values).max(axis=0), self._sizes)

    def _sizes_at_start(self) -> Float[np.ndarray, " wishes"]:
        """The magnitudes of the wishes around the problem's start."""
        transcribed = transcribe(self._wishes.unscaled().problem, self._transcription)
        names = [one.name for one in transcribed.problem.constraints]
        found = np.array([transcribed.scales[names.index(pressed(name))] for name in self._wishes.names])
        return np.where(np.isfinite(found) & (found > 0), found, 1.0)

    def _global(self, which: int) -> Mapping[str, Any] | None:
        """Where one wish is least everywhere, as far as a global search tells; None if none is asked for."""
        if self._starts == 1:
            return None
        problem = self._wishes.only(which)
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        return portfolio(problem, self._starts, search=search, solver=self._solver).best.decisions

    def problems(self, method: Method, points: int) -> Iterator[Compromise]:
        """The problems of further points, each chosen by what has been found before."""
        if self._is_constant(np.array(self.anchors)).all():
            return
        scales = 1.0 / np.where(self._range > 0, self._range, 1.0)
        more = points - len(self.anchors)
        if method == "weights":
            yield from (self._wishes.weighted(one, scales) for one in simplex(len(scales), more))
        elif method == "limits":
            yield from self._limited(scales, more)
        elif method == "boundary":
            yield from self._along(scales, more)
        elif method == "population":
            yield from (self._wishes.along(one.values, scales) for one in self._crowd)
        else:
            assert_never(method)

    def add(self, compromise: Compromise) -> None:
        """Solve one of these problems, from the nearest design."""
        known = [*self._found.values, *(one.values for one in self._crowd)]
        starts = [*self._found.solutions, *(one.decisions for one in self._crowd)]
        self._solve(compromise, self._found, start=starts[np.argmin([compromise.distance(one) for one in known])])

    def spread(self, points: int, budget: Budget, heed: Callable[[int], Any]) -> None:
        """Let a population spread over the front."""
        self._crowd = crowd(self._wishes, self._found.solutions, points - len(self.anchors), budget, heed)

    def told(self, interrupted: bool) -> TradeOff:
        """The efficient designs in order."""
        values, best = np.array(self._found.values), self._best
        span = np.where(self._range > 0, self._range, np.maximum(np.abs(best), 1e-12))
        kept = efficient(values, _SAME * span)
        distinct: list[int] = []
        for i in np.argsort(values[:, 0], kind="stable"):
            if kept[i] and all((np.abs(values[i] - values[j]) > 10 * _SAME * span).any() for j in distinct):
                distinct.append(int(i))
        solutions = [self._found.solutions[i] for i in distinct]
        return TradeOff(
            names=self._wishes.names,
            wishes=self._wishes.expressions,
            values=values[distinct],
            solutions=tuple(solutions),
            best=best,
            worst=np.max(self.anchors, axis=0),
            weights=np.array(self._found.weights)[distinct],
            dominated=int((~kept).sum()),
            failed=tuple(self._found.failed),
            interrupted=interrupted,
        )

    def _limited(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Limits on all wishes but the first, on a grid over their ranges."""
        others = len(scales) - 1
        each = max(round(count ** (1 / others)), 1)
        parts = np.arange(1, each + 1) / (each + 1)
        for at in np.stack(np.meshgrid(*[parts] * others), axis=-1).reshape(-1, others):
            yield self._wishes.within(0, self._best + np.append(0.0, at) * self._range, scales)

    def _along(self, scales: Float[np.ndarray, " wishes"], count: int) -> Iterator[Compromise]:
        """Lines from between the anchors; for two wishes, in the middle of the largest gap."""
        corners = np.array(self.anchors)
        if len(corners) > 2:
            yield from (self._wishes.along(one @ corners, scales) for one in simplex(len(corners), count))
            return
        gaps = [Gap(0.0, 1.0, *corners)]
        for _ in range(count):
            gaps = [one for one in gaps if one.width > _NARROWEST]
            if not gaps:
                return
            widest = max(gaps, key=lambda one: one.size(scales))
            gaps.remove(widest)
            middle, known = (widest.first + widest.last) / 2, len(self._found.values)
            yield self._wishes.along(corners[0] + middle * (corners[1] - corners[0]), scales)
            if len(self._found.values) > known:
                point = self._found.values[-1]
                halves = (
                    Gap(widest.first, middle, widest.before, point),
                    Gap(middle, widest.last, point, widest.after),
                )
                gaps += [one for one in halves if one.size(scales) > _SAME]

    def _local(self, problem: Problem, start: _Start) -> Solution:
        """The first solution of the ways tried; the last one if none is."""
        solution = None
        for solver, begun in self._ways(start):
            design = begun if isinstance(begun, Solution) else None
            values = None if isinstance(begun, Solution) else begun
            with warned_of("trade_off"):
                solution = solve(
                    problem,
                    solver,
                    transcription=self._transcription,
                    warm_start=design,
                    start=values,
                    throw=False,
                )
            if solution.ok:
                break
        assert solution is not None
        return solution

    def _ways(self, start: _Start) -> Iterator[tuple[AbstractSolver | None, _Start]]:
        """Solvers and starts to be tried; SLSQP makes ever longer steps where wishes are linear, others do not."""
        yield self._solver, start
        if start is not None:
            yield self._solver, None
        if self._solver is None:
            yield Slsqp(), start

    def _solve(self, compromise: Compromise, found: Found, start: _Start) -> None:
        solution = self._local(compromise.problem, start)
        if self._starts > 1:
            with warned_of("trade_off"):
                other = portfolio(compromise.problem, self._starts, search=None, solver=self._solver).best
            solution = min((one for one in (solution, other)), key=lambda one: (not one.ok, one.objective))
        if not solution.ok:
            found.failed.append(solution.why())
            return
        found.solutions.append(solution)
        found.values.append(compromise.values(solution))
        found.weights.append(compromise.weights(solution))
