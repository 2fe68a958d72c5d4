"""`multistart` and `portfolio`: one problem from many starts, and how sure one may be of the best of their optima."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, members, one_of, positive, refusal, silent, whole
from aleator._core.errors import ProblemError, warned_of
from aleator._core.journalled import journalled
from aleator._core.leaves import Drawn
from aleator.design import Problem
from aleator.nlp import AbstractSearch, AbstractSolver, DifferentialEvolution, Outcome, Searched, variable_range
from aleator.solution import Solution
from aleator.solving import check_search, solve
from aleator.sweep._printed import listed
from aleator.sweep._runner import SOLVE, Work, finished, running
from aleator.transcription import DEFAULT, AbstractTranscription, transcribe, valued_by
from aleator.uncertainty import refuse_choices

# Objectives, or decisions, with a smaller relative difference belong to one optimum, and so do objectives whose
# difference is below this part of those at the starts, since they may be zero.
_SAME, _NONE = 1e-4, 1e-9
# With fewer random starts, or with not this many more than optima, nothing can be said of those not seen: there the
# estimate is a number without meaning (Boender and Rinnooy Kan 1987 need two more for its mean, three for its spread).
_FEWEST, _MORE = 6, 3
# Optima that are certified at most, from the best one on, until one stands.
_CERTIFIED = 5


def _alike(
    ends: Sequence[tuple[float, Float[np.ndarray, " n"]]], visited: Sequence[Searched | None]
) -> list[list[int]]:
    """The local optima at which searches ended, best first: the indices of the ends that belong to each.

    Mirrored designs count as one, by their objective, and so do equal designs.

    - `ends`: objectives and points; `visited`: the courses of the searches, which tell the magnitude of the objective.
    """
    size = np.max([np.abs(point) for _, point in ends], axis=0, initial=1e-12) if ends else np.zeros(0)
    first = np.abs([one.objectives[0] for one in visited if one is not None and len(one.objectives)])
    first = first[np.isfinite(first)]
    least = _NONE * float(np.median(first)) if first.size else 0.0
    groups: list[list[int]] = []
    for i in np.argsort([objective for objective, _ in ends], kind="stable").tolist():
        objective, point = ends[i]
        if groups:
            best, place = ends[groups[-1][0]]
            near = max(_SAME * max(abs(objective), abs(best)), least)
            if abs(objective - best) <= near or np.all(np.abs(point - place) < _SAME * size):
                groups[-1].append(i)
                continue
        groups.append([i])
    return groups


def _least_violated(violations: Sequence[float]) -> int:
    return int(np.argmin(np.nan_to_num(violations, nan=np.inf)))


def _listed(optima: Sequence[tuple[float, int]], starts: int, *further: str, interrupted: bool) -> str:
    """Local optima in lines: the objective of each, and how many of the starts led to it."""
    failed = starts - sum(count for _, count in optima)
    rows = ["local optima (equal objectives count as one)"]
    rows += [f"{objective:14.8g}  from {count} of {starts} starts" for objective, count in optima]
    rows += [f"{failed} starts failed"] if failed else []
    return listed([*rows, *further], interrupted=interrupted)


@final
@dataclass(frozen=True)
class Starts(Drawn):
    """A problem solved from several starts. `print(starts)` lists its local optima.

    - `solutions`: one per start, in order, failed ones included;
    - `interrupted`: whether it was stopped early; the solutions finished by then are included.
    """

    solutions: tuple[Solution, ...]
    interrupted: bool = False

    @property
    def best(self) -> Solution:
        """The best solved one; if none is solved, the least violated."""
        solved = [one for one in self.solutions if one.ok]
        least = self.solutions[_least_violated([one.certificate.violation for one in self.solutions])]
        return min(solved, key=lambda one: one.objective, default=least)

    @property
    def optima(self) -> tuple[tuple[Solution, int], ...]:
        """The local optima, best first, each with the number of starts that led to it.

        Solutions with the same objective count as one, mirrored plans included, and so do those with the same
        decisions, since the objective may be zero.
        """
        solved = [one for one in self.solutions if one.ok]
        groups = _alike([(one.objective, one.vector) for one in solved], [one.effort.visited for one in self.solutions])
        return tuple((solved[group[0]], len(group)) for group in groups)

    def __str__(self) -> str:
        optima = [(solution.objective, count) for solution, count in self.optima]
        return _listed(optima, len(self.solutions), interrupted=self.interrupted)


@final
@dataclass(frozen=True)
class Optimum:
    """A local optimum of the program.

    - `objective`, `decisions`: by name;
    - `starts`: how many local searches ended there; `random`: how many of these began at a random point, whose share
      is that of its basin.
    """

    objective: float
    decisions: dict[str, Any]
    starts: int
    random: int


@final
@dataclass(frozen=True)
class Portfolio(Drawn):
    """What a global search and many local ones found. `print(portfolio)` lists the optima.

    - `best`: the best optimum with its certificate; if that fails, the next one whose certificate stands; if there is
      none, the least violated design, with the reason;
    - `optima`: different local optima of the program, best first;
    - `starts`, `random`: local searches in all, and from random starts; `solved`: those of the random ones that ended
      at an optimum;
    - `searched`: the history of the global search; None if there was none;
    - `proven`: whether no design can be better, because the objective is at its lower bound;
    - `interrupted`: whether Ctrl-C ended it; what was found by then is kept, and certified.
    """

    best: Solution
    optima: tuple[Optimum, ...]
    starts: int
    random: int
    solved: int
    searched: Searched | None
    proven: bool = False
    interrupted: bool = False

    @property
    def unseen(self) -> float:
        """The expected share of starts that lead to optima not seen yet: `w (w + 1) / (n (n - 1))`.

        For `w` optima seen from `n` uniform random starts (Boender and Rinnooy Kan 1987). 1 for too few starts to say
        anything: fewer than six, or than three more than optima.
        """
        w, n = self._seen_at_random, self.solved
        return w * (w + 1) / (n * (n - 1)) if n >= max(_FEWEST, w + _MORE) else 1.0

    @property
    def _seen_at_random(self) -> int:
        return sum(one.random > 0 for one in self.optima)

    def sure(self) -> str:
        """How sure one may be that no design is better, in words."""
        if self.proven:
            return "No design is better: the objective is at its lower bound."
        if self.unseen == 1.0:
            return (
                f"Too few random starts ended at an optimum to say how many others there are: {self.solved}, at "
                f"{self._seen_at_random} optima. Nothing can be said of designs not seen; take more starts."
            )
        best = self.optima[0]
        found = f"{best.random} of {self.solved} random starts" if best.random else "Only the global search"
        return (
            f"{found} led to the best one; a further random start would lead to an optimum not seen yet with a "
            f"probability of about {self.unseen:.0%} (Boender and Rinnooy Kan 1987)."
        )

    def __str__(self) -> str:
        searched = [str(self.searched)] if self.searched else []
        further = *searched, f"best: {self.best.objective:.8g}, {self.best.why()}", self.sure()
        optima = [(one.objective, one.starts) for one in self.optima]
        return _listed(optima, self.starts, *further, interrupted=self.interrupted)


def multistart(
    problem: Problem,
    starts: int | Sequence[Mapping[str, Any]] = 10,
    *,
    spread: float = 0.3,
    seed: int = 0,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Starts:
    """Solve a problem from several starts, given by decisions' names, or from a number of random ones.

    The first random start is the problem's own; the others, drawn from `seed`, differ from it by up to `spread` of each
    decision's range (of its magnitude where a bound is infinite). The problem is compiled once. A start that fails is
    kept with its status; Ctrl-C ends the search and returns the finished solutions. `solver` and `transcription` are
    those of `al.solve`; an `executor` (see `al.pareto`) solves from several starts at once.

    Raises `ProblemError`, before anything is solved, if there is no start, for unknown decisions, and for values that
    are not finite or of the wrong shape.
    """
    one_of("multistart: problem", problem, Problem)
    spread, seed = positive("multistart: spread", spread), whole("multistart: seed", seed, least=0)
    if not isinstance(starts, Sequence):
        count = whole("multistart: starts, which may be a list of starts by name or their number,", starts)
        starts = _around(problem, count, spread, seed)
    if not members("multistart: starts", starts, Mapping):
        raise refusal("multistart: starts", "at least one start", starts)
    for start in starts:
        problem.placements.moved(problem.placements.vector("initial"), start)
    own = {"problem": problem, "solver": solver, "transcription": transcription}
    calls = [{**own, "start": start} for start in starts]
    solutions: dict[int, Solution] = {}
    with running("multistart", lambda: solutions, progress, executor) as run:
        # One by one, so that Ctrl-C keeps those that are there.
        solutions.update(run.each(SOLVE, "starts", calls, [f"from start {i + 1}" for i in range(len(calls))]))
    return Starts(tuple(solutions[i] for i in sorted(solutions)), run.interrupted)


def _around(problem: Problem, count: int, spread: float, seed: int) -> list[dict[str, Any]]:
    """The problem's own start, and random ones around it."""
    places = problem.placements
    first, lower, upper = (places.vector(name) for name in ("initial", "lower", "upper"))
    reach = spread * np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(first), 1.0))
    shifts = np.random.default_rng(seed).uniform(-1.0, 1.0, (count - 1, first.size))
    return [places.named(np.clip(first + reach * shift, lower, upper)) for shift in (np.zeros(first.size), *shifts)]


def portfolio(
    problem: Problem,
    starts: int = 20,
    *,
    search: AbstractSearch | None = DifferentialEvolution(),  # noqa: B008 -- frozen
    solver: AbstractSolver | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Portfolio:
    """Look for the best of all designs: search globally, then locally from many points, then certify the best optimum.

    The global search costs simulations without derivatives, many in one call. Half of the local searches begin at its
    best points that lie apart, the others at uniformly random ones, which tell how many optima there may be. The
    problem is compiled once, states are simulated (`al.Sequential()`), and only the best optimum is certified, or the
    next ones where its certificate fails. Ctrl-C ends the searches and certifies the best so far.

    - `starts`: local searches in all; `search`: None leaves the global search out;
    - `solver`: of the local searches, `al.solvers.FilterSQP()` by default; `seed`: of the random starts;
    - `executor`: simulates generations of the global search, and does several local searches at once (see `al.pareto`),
      with the same results.

    Within `al.journal(folder)` the global search and each local one are kept as soon as they have ended.

    Raises `ProblemError` for too few starts, and for decisions without bounds if there is a search that needs them.
    """
    refuse_choices("portfolio", one_of("portfolio: problem", problem, Problem).placements)
    starts, seed = whole("portfolio: starts", starts), whole("portfolio: seed", seed, least=0)
    if search is not None:
        one_of("portfolio: search", search, AbstractSearch, "al.solvers.DifferentialEvolution(), or None")
        check_search("portfolio", problem, search, "search=None leaves the global search out.")
    local = one_of("portfolio: solver", solver or DEFAULT.solver, AbstractSolver, "al.solvers.FilterSQP()").local
    program = transcribe(problem, DEFAULT).program
    lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
    candidates: list[Float[np.ndarray, " n"]] = []
    searched: Searched | None = None
    known = 0  # local searches that do not begin at random
    outcomes: dict[int, Outcome] = {}

    def globally(search: AbstractSearch, count: int) -> tuple[list[Float[np.ndarray, " n"]], Searched, bool]:
        """Points that lie apart, best first, the history, and whether Ctrl-C ended it; from a journal, if one has it.

        An executor finds the values of whole generations, not those of one point after the other.
        """

        def found() -> tuple[list[Float[np.ndarray, " n"]], Searched, bool]:
            sought, history = search.seek(valued_by(executor if search.at_once else None, program, "portfolio"))
            return sought.candidates(count), history, sought.halt is not None

        given = {"problem": problem, "search": replace(search, progress=silent), "count": count}
        return journalled("global search", given, found)

    with running("portfolio", lambda: outcomes or candidates, progress, executor) as run:
        if search is not None:
            candidates, searched, is_interrupted = globally(search, max(starts // 2, 1))
            if is_interrupted:
                raise KeyboardInterrupt
        chosen = [*candidates, program.start][:starts]
        known = len(chosen)
        drawn = np.random.default_rng(seed).uniform(lower, upper, (starts - known, lower.size))
        calls = [{"problem": problem, "solver": local, "start": point} for point in (*chosen, *drawn)]
        places = [f"local search {i + 1}" for i in range(starts)]
        outcomes.update(run.each(LOCAL_SEARCH, "local searches", calls, places))
    every = dict(sorted(outcomes.items()))
    solved = [i for i, one in every.items() if one.ok]
    ends = [(every[i].evaluation.objective, every[i].point) for i in solved]
    groups = _alike(ends, [one.visited for one in every.values()])
    points = [ends[group[0]][1] for group in groups[:_CERTIFIED]]
    if not points and every:
        tried = list(every.values())
        points = [tried[_least_violated([one.violation for one in tried])].point]
    points = points or candidates[:1]
    try:
        best = _certified(problem, local, search, points)
    except KeyboardInterrupt:
        # Here Ctrl-C ends the comparison, not the certificate, without which there would be no result.
        run.interrupted = True
        best = _certified(problem, local, search, points[:1])
    optima = (
        Optimum(
            ends[group[0]][0],
            problem.placements.named(ends[group[0]][1]),
            starts=len(group),
            random=sum(solved[i] >= known for i in group),
        )
        for group in groups
    )
    return Portfolio(
        best=best,
        optima=tuple(optima),
        starts=len(every),
        random=sum(i >= known for i in every),
        solved=sum(i >= known for i in solved),
        searched=searched,
        proven=best.ok and program.is_least(best.objective, local.tolerance),
        interrupted=run.interrupted,
    )


def _certified(
    problem: Problem, solver: AbstractSolver, search: AbstractSearch | None, ends: Sequence[Float[np.ndarray, " n"]]
) -> Solution:
    """The first of some ends whose certificate stands, else the first one."""
    solutions: list[Solution] = []
    for end in ends:
        own = {"start": problem.placements.named(end), "throw": False}
        with warned_of("portfolio"):
            try:
                solutions.append(finished(solve(problem, solver, **own)))
            except ProblemError:
                if search is None:
                    raise
                # Derivatives cannot choose, but values have: the end is judged as the answer of a search of one.
                solutions.append(finished(solve(problem, replace(search, evaluations=1), **own)))
        if solutions[-1].ok:
            return solutions[-1]
    return solutions[0]


def _searched_locally(**arguments: Any) -> Outcome:
    program = transcribe(arguments["problem"], DEFAULT).program
    solver: AbstractSolver = arguments["solver"]
    return journalled(LOCAL_SEARCH.name, arguments, lambda: solver.solve(program, start=arguments["start"]))


LOCAL_SEARCH = Work("local search", dict, _searched_locally)
