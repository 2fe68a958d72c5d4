"""`multistart` and `portfolio`: one problem from many starts, those of a search everywhere among them."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, members, one_of, positive, refusal, silent, whole
from aleator._core.errors import ProblemError, warned_of
from aleator._core.journalled import journalled
from aleator.design import Problem
from aleator.nlp import (
    AbstractSearch,
    AbstractSolver,
    DifferentialEvolution,
    NonlinearProgram,
    Outcome,
    Searched,
    Status,
    variable_range,
)
from aleator.solution import Solution
from aleator.solving import check_search, solve
from aleator.sweep._runner import SOLVE, Work, finished, running
from aleator.sweep._starts import Optimum, Portfolio, Starts, alike
from aleator.transcription import DEFAULT, AbstractTranscription, transcribe, valued_by
from aleator.uncertainty import refuse_choices

# Optima that are certified at most, from the best one on, until one stands.
_CERTIFIED = 5


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
    candidates: list[Float[np.ndarray, " n"]] = []
    searched: Searched | None = None
    known = 0  # local searches that do not begin at random
    outcomes: dict[int, Outcome] = {}
    with running("portfolio", lambda: outcomes or candidates, progress, executor) as run:
        if search is not None:
            found = _searched_globally(problem, program, search, max(starts // 2, 1), executor)
            candidates += found.candidates
            searched = found.searched
            finished(found)
        chosen = [*candidates, program.start][:starts]
        known = len(chosen)
        lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
        drawn = np.random.default_rng(seed).uniform(lower, upper, (starts - known, lower.size))
        calls = [{"problem": problem, "solver": local, "start": point} for point in (*chosen, *drawn)]
        places = [f"local search {i + 1}" for i in range(starts)]
        outcomes.update(run.each(LOCAL_SEARCH, "local searches", calls, places))
    every = dict(sorted(outcomes.items()))
    solved = [i for i, one in every.items() if one.ok]
    objectives, points = [every[i].evaluation.objective for i in solved], [every[i].point for i in solved]
    optima = alike(objectives, points, [one.visited for one in every.values()])
    ends = [points[group[0]] for group in optima[:_CERTIFIED]]
    if not ends and every:  # the least violated design
        ends = [min(every.values(), key=lambda one: np.nan_to_num(one.violation, nan=np.inf)).point]
    ends = ends or candidates[:1]
    try:
        best = _certified(problem, local, search, ends)
    except KeyboardInterrupt:
        # Here Ctrl-C ends the comparison, not the certificate, without which there would be no result.
        run.interrupted = True
        best = _certified(problem, local, search, ends[:1])
    return Portfolio(
        best=best,
        optima=tuple(
            Optimum(
                objective=objectives[group[0]],
                decisions=problem.placements.named(points[group[0]]),
                starts=len(group),
                random=sum(solved[i] >= known for i in group),
            )
            for group in optima
        ),
        starts=len(every),
        random=sum(i >= known for i in every),
        solved=sum(i >= known for i in solved),
        searched=searched,
        proven=best.ok and _is_least(program, best.objective, local.tolerance),
        interrupted=run.interrupted,
    )


def _is_least(program: NonlinearProgram, objective: float, tolerance: float) -> bool:
    """Whether an objective is at its lower bound, as far as can be told beside its fall from the start."""
    above = program.evaluate(program.start).objective - program.least
    return bool(np.isfinite(program.least)) and bool(objective - program.least <= tolerance * above)


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


class _FoundGlobally(NamedTuple):
    """Points of a global search that lie apart, best first, and its history; `status` tells if the user ended it."""

    candidates: list[Float[np.ndarray, " n"]]
    searched: Searched
    status: Status


def _searched_globally(
    problem: Problem, program: NonlinearProgram, search: AbstractSearch, count: int, executor: Executor | None
) -> _FoundGlobally:
    """At most `count` points of a global search; from a journal, if one has them.

    An executor finds the values of whole generations, not those of one point after the other.
    """

    def found() -> _FoundGlobally:
        sought, searched = search.seek(valued_by(executor if search.at_once else None, program, "portfolio"))
        status = Status.SOLVED if sought.halt is None else Status.INTERRUPTED
        return _FoundGlobally(sought.candidates(count), searched, status)

    given = {"problem": problem, "search": replace(search, progress=silent), "count": count}
    return journalled("global search", given, found)


def _searched_locally(**arguments: Any) -> Outcome:
    program = transcribe(arguments["problem"], DEFAULT).program
    solver: AbstractSolver = arguments["solver"]
    return journalled(LOCAL_SEARCH.name, arguments, lambda: solver.solve(program, start=arguments["start"]))


LOCAL_SEARCH = Work("local search", dict, _searched_locally)
