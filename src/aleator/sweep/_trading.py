"""`trade_off`: designs of which none is better in one wish without being worse in another.

First come the anchors, the best designs of each wish, at which the others are as good as they can be without making it
worse; then further points on lines through their wishes, each chosen by those before.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, final, get_args

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.border import Progress, a_name, one_of, refusal, silent, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver, DifferentialEvolution, Slsqp, load_pymoo
from aleator.solution import Solution
from aleator.solving import check_search, solve
from aleator.sweep._population import crowd
from aleator.sweep._portfolio import portfolio
from aleator.sweep._runner import Runner, finished, running
from aleator.sweep._trade_off import Line, TradeOff, across, box, efficient, simplex
from aleator.sweep._wishes import Compromise, Design, Wishes
from aleator.transcription import DEFAULT, AbstractTranscription
from aleator.uncertainty import refuse_choices

Method: TypeAlias = Literal["boundary", "population"]
Start: TypeAlias = Solution | Mapping[str, Any] | None

# A wish of a smaller range, as a part of its magnitude, is constant; an improvement by less of the range is none.
_CONSTANT, _SAME = 1e-9, 1e-5
# What a wish may give up, as a part of its range and of its least value, while the others are improved, though not less
# of its range than counts as rounding. An improvement that is not many times what the price of the wish makes of that
# has been bought by it.
_GIVEN_UP, _OF_LEAST, _LEAST_SLACK, _BOUGHT, _STEEPER = 1e-7, 1e-3, 1e-11, 20.0, 1.1
# Lines that are nearer to one another, or to a design, as parts of the whole, are the same.
_NARROWEST = 1e-3
# Anchors whose differences span less than this part of their range in some direction lie on no simplex.
_FLAT = 1e-3
# So many lines at most for each point asked for, since some pass by the front, of so many among which to choose.
_LINES, _CHOICES = 2, 20


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
      the best ones of the wishes included. There are fewer where some turn out to be the same, as `print` tells;
    - `method`: how points are chosen. `"boundary"`: along parallel lines from between the best designs of each wish
      towards better ones (normal boundary intersection, Das and Dennis 1998, in the form of Pascoletti and Serafini
      1984), where fronts may be concave; each line is as far from the points before as can be. For three wishes or
      more, parts of the front that lie beyond the best designs are not reached, unless these coincide: lines then cross
      the whole box between best and worst. `"population"`: a population spreads over the whole front
      (NSGA-II, Deb et al. 2002, of the extra `fronts`), for fronts in parts and designs in many basins; its designs are
      starts of lines through them, which lead to the front itself. A small share of all wishes in every objective keeps
      designs away at which a wish could be better at no cost (Mavrotas 2009);
    - `solver`, `transcription`: those of `al.solve`, which certifies every point. Each point starts from the known
      design that is best for it, from the problem's own start where that fails, and then by `al.solvers.Slsqp()` unless
      a solver is given. One that ends at a known design is sought again from between its neighbours;
    - `starts`: local searches for each point, all but one from random starts, for problems with several optima, whose
      fronts may be in parts; the best designs of the wishes are then searched for globally (see `al.portfolio`);
    - `evaluations`, `seed`: of a population: simulated designs, and its random numbers;
    - `executor`: simulates the generations of a population, and does the local searches of `starts` at once (see
      `al.pareto`), with the same front.

    At the best design of a wish, the others are improved as far as they can be without making it worse (lexicographic
    order). Everything is compiled once. Ctrl-C returns the points found so far; in a population it ends that, whose
    designs until then lead to points, and a second one ends these. Raises `ProblemError` for fewer than two wishes, if
    the best design of some wish cannot be found, for a limit whose price (`al.soft` with `exact=True`) would not count,
    and for decisions without bounds if a population is asked for.
    """
    refuse_choices("trade_off", one_of("trade_off: problem", problem, Problem).placements)
    _check_wishes(problem, wishes)
    points = whole("trade_off: points", points, least=len(wishes))
    starts, seed = whole("trade_off: starts", starts), whole("trade_off: seed", seed, least=0)
    evaluations = whole("trade_off: evaluations", evaluations)
    if method not in get_args(Method):
        raise refusal("trade_off: method", '"boundary" or "population"', method)
    if method == "population":
        load_pymoo('trade_off: method="population"')
        check_search("trade_off", problem, DifferentialEvolution(), 'method="boundary" needs none.')
    one_of("trade_off: transcription", transcription, AbstractTranscription, "al.Sequential()")
    search = Search(Wishes(problem, wishes), points, transcription, solver, starts, executor)
    with running("trade_off", lambda: search.designs, progress, executor) as run:
        search.find_anchors(run)
        is_spread = method == "population"
        lines = crowd(search.wishes, search.designs, points, evaluations, seed, run) if is_spread else search.lines()
        search.find_along(lines, run)
    return search.result(run.interrupted)


def _check_wishes(problem: Problem, wishes: Mapping[str, Expression]) -> None:
    """Refuse what are no wishes by name, and prices in the problem's objective, which would not count."""
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        expected = "two expressions or more by name, such as {'ride': ..., 'cost': ...}"
        raise refusal("trade_off: wishes", expected, wishes)
    for name, one in wishes.items():
        one_of(f"trade_off: wish '{a_name('trade_off: the name of a wish', name)}'", one, Expression)
    for name in problem.names:
        excess = f"{name}.excess"
        if excess in problem.placements.decisions and not any(excess in str(one) for one in wishes.values()):
            raise ProblemError(
                f"trade_off: problem: the price of the soft limit '{name}' is in the objective, which does not count "
                f"here, so that nothing would hold it: add al.value('{excess}') to a wish, or give the problem before "
                "al.soft."
            )


@final
@dataclass(eq=False)
class Search:
    """A search for a front of so many `points`, by solves as the other arguments of `trade_off` tell.

    - `designs`: those found, the anchors first, in the order of the wishes.
    """

    wishes: Wishes
    points: int
    transcription: AbstractTranscription
    solver: AbstractSolver | None
    starts: int
    executor: Executor | None
    designs: list[Design] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.count = len(self.wishes.names)
        self._least = np.full(self.count, np.inf)  # of each wish alone
        self._failed: list[str] = []
        self._tried: list[Float[np.ndarray, " wishes"]] = []  # the places of lines

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

        def solved(solver: AbstractSolver | None, begun: Start) -> Solution:
            design = {"warm_start": begun} if isinstance(begun, Solution) else {"start": begun}
            own = {"transcription": self.transcription, "throw": False}
            return finished(solve(compromise.problem, solver, **design, **own))

        solution = solved(*tries[0])
        for again in tries[1:]:
            solution = solution if solution.ok else solved(*again)
        return solution

    # --- Anchors -----------------------------------------------------------------------------------------------------

    @property
    def _corners(self) -> Float[np.ndarray, "anchors wishes"]:
        """The wishes at the anchors, in their own units."""
        return np.array([one.values for one in self.designs[: self.count]])

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
        transcribed = self.wishes.transcribed(self.transcription)
        sizes = np.array(transcribed.scales[-self.count :])
        self._sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
        task, count = "best of each wish", self.count
        for which in range(count):
            with run.step(task, which, count, task):
                self.designs.append(self._alone(which, self._everywhere(which)))
        with run.step(task, count, count, task):
            # Where another's design is better in a wish than its own, that ended at a worse optimum or on a plateau.
            for which, own in enumerate(self.designs):
                rival = self.designs[int(np.argmin(self._corners[:, which]))]
                if rival.values[which] < own.values[which] - _SAME * self._range[which]:
                    self.designs[which] = self._alone(which, rival.solution.decisions)
        scales = self._scales
        for which in range(count if not self._constant.all() else 0):
            with run.step(task, which, count, task):
                self.designs[which] = self._improved(which, scales)

    def _everywhere(self, which: int) -> Start:
        """Where a wish is least everywhere, as far as a global search tells; None if none is asked for."""
        if self.starts == 1:
            return None
        problem = self.wishes.only(which)
        lower, upper = (problem.placements.vector(name) for name in ("lower", "upper"))
        search = DifferentialEvolution() if np.isfinite(upper - lower).all() else None
        own = {"solver": self.solver, "executor": self.executor}
        return portfolio(problem, self.starts, search=search, **own).best.decisions

    def _alone(self, which: int, start: Start) -> Design:
        """The best design of a wish, whatever becomes of the others."""
        own = np.eye(self.count)[which]
        alone = self.wishes.compromise(1.0 / self._sizes, np.inf, direction=0.0, shares=own)
        design, reason = self._sought(alone, start)
        if design is None:
            name = self.wishes.names[which]
            raise ProblemError(f"trade_off: the best design for '{name}' alone was not found: {reason}")
        self._least[which] = design.values[which]
        return design._replace(weights=np.full(self.count, np.nan), factors=own)

    def _improved(self, which: int, scales: Float[np.ndarray, " wishes"]) -> Design:
        """The best design of a wish after the others were improved while it is held, with the prices there."""
        alone, others = self.designs[which], np.arange(self.count) != which
        least = scales[which] * alone.values[which]
        slack = float(np.clip(_OF_LEAST * abs(least), _LEAST_SLACK, _GIVEN_UP)) if least else _GIVEN_UP
        most = np.where(others, np.inf, scales * alone.values + slack)
        held = self.wishes.compromise(scales, most, direction=0.0, shares=others.astype(float))
        design, _ = self._sought(held, alone.solution.decisions)
        if design is None:
            return alone
        better = float((scales * (alone.values - design.values))[others].sum())
        bought = design.weights[which] / scales[which] * slack
        if better > max(_SAME, _BOUGHT * bought):
            return design
        # Where much more was bought than by a constant price, the front is ever steeper towards its end.
        return alone if better > max(_SAME, _STEEPER * bought) else alone._replace(weights=design.weights)

    # --- Further points ----------------------------------------------------------------------------------------------

    def lines(self) -> list[Line]:
        """Lines through all places between the anchors; where these lie on no simplex, through the whole box between
        best and worst.
        """
        corners, count = self._corners, _CHOICES * (self.points - self.count)
        if np.linalg.svd((corners[1:] - corners[0]) * self._scales)[1][-1] > _FLAT:
            return list(map(Line, simplex(self.count, count) @ corners))
        best = np.minimum(corners.min(axis=0), self._least)
        return list(map(Line, best + box(self.count, count) * self._range))

    def find_along(self, lines: Sequence[Line], run: Runner) -> None:
        """Find the last point on some lines, each as far from designs and from lines before as can be."""
        if self._constant.all() or not lines:
            return
        scales, further = self._scales, self.points - self.count
        places = across(np.array([one.through for one in lines]) * scales)
        for done in range(_LINES * further):
            known = np.array([*(across(one.values * scales) for one in self.designs), *self._tried])
            away = np.abs(places[:, None] - known).max(axis=2).min(axis=1)
            if len(self._distinct()) >= self.points or away.max() < _NARROWEST:
                return
            chosen = int(np.argmax(away))
            self._tried.append(places[chosen])
            with run.step("trade-off", done, _LINES * further, f"line {done + 1}"):
                self._add(lines[chosen])

    def _add(self, line: Line) -> None:
        """Solve for a point, from the best known design on its line; again from others if it ends at a known one."""
        compromise, known = self.wishes.compromise(self._scales, self._scales * line.through), list(self.designs)
        # No design that is found by small steps from the best known one is dominated by that.
        best = min(known, key=lambda one: compromise.level(one.values)).solution
        design, reason = self._sought(compromise, best if line.start is None else line.start)
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

    def _around(self, compromise: Compromise, designs: list[Design]) -> Iterator[Start]:
        """Starts elsewhere: between the nearest designs to all sides of a line, and the problem's own."""
        nearest: dict[tuple[int, bool], Mapping[str, Any]] = {}
        for one in sorted(designs, key=lambda one: float(np.ptp(compromise.away(one.values)))):
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
        is_sought = np.arange(self.count) < len(self.designs)
        return TradeOff(
            names=self.wishes.names,
            wishes=self.wishes.expressions,
            values=values[distinct],
            solutions=tuple(self.wishes.solution_of(self.designs[i]) for i in distinct),
            best=np.where(is_sought, np.minimum(values.min(axis=0), self._least), np.nan),
            worst=self._corners.max(axis=0),
            weights=np.array([self.designs[i].weights for i in distinct]),
            asked=self.points,
            dominated=int((~efficient(values, _SAME / self._scales)).sum()),
            holes=self._holes(values[distinct]) if self.count == 2 else (),
            failed=tuple(self._failed),
            interrupted=interrupted,
        )

    def _holes(self, values: Float[np.ndarray, "points 2"]) -> tuple[tuple[float, float], ...]:
        """The gaps of a front between whose ends lines have ended at none of its points."""
        places, tried = (np.reshape(one, (-1, 2))[:, 0] for one in (across(values * self._scales), self._tried))
        lost = tried[np.abs(tried[:, None] - places).min(axis=1) > _NARROWEST]
        gaps = zip(values[:, 0], values[1:, 0], places, places[1:], strict=False)
        return tuple((float(a), float(b)) for a, b, low, high in gaps if np.any((low < lost) & (lost < high)))
