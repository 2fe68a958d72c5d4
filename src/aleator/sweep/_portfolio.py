"""`portfolio`: a search everywhere and local searches from what it found, each kept by a journal as soon as it ends."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import Progress, check_progress, one_of, silent, whole
from aleator._core.errors import ProblemError, warned_of
from aleator._core.executors import check_executor, each_done
from aleator._core.journalled import entry_of, journalled
from aleator._core.leaves import Drawn, Printed
from aleator.design import Problem, refuse_other_code
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
from aleator.sweep._each import until_interrupted
from aleator.transcription import DEFAULT, transcribe, valued_by

# Objectives, or decisions, with a smaller relative difference belong to one optimum, and so do objectives whose
# difference is below this part of those at the starts, since they may be zero.
_SAME, _NONE = 1e-4, 1e-9
# With fewer random starts, or with not this many more than optima, nothing can be said of those not seen: there the
# estimate is a number without meaning (Boender and Rinnooy Kan 1987 need two more for its mean, three for its spread).
_FEWEST, _MORE = 6, 3
# Optima that are certified at most, from the best one on, until one stands.
_CERTIFIED = 5


@final
@dataclass(frozen=True)
class Optimum(Printed):
    """A local optimum of the program.

    - `objective`, `decisions`: by name;
    - `starts`: how many local searches ended there; `random`: how many of these began at a random point, whose share
      is that of its basin.
    """

    objective: float
    decisions: dict[str, Any]
    starts: int
    random: int

    def __str__(self) -> str:
        decided = ", ".join(
            f"{name} = {np.array2string(np.asarray(one), precision=5)}" for name, one in self.decisions.items()
        )
        return f"{self.objective:.8g} from {self.starts} starts ({self.random} of them random), at {decided}"


@final
@dataclass(frozen=True)
class Portfolio(Drawn):
    """What a global search and many local ones found. `print(portfolio)` lists the optima.

    - `best`: the best optimum with its certificate; if that fails, the next one whose certificate stands; if there is
      none, the least violated design, with its status;
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
    def seen_at_random(self) -> int:
        """How many optima random starts have led to."""
        return sum(one.random > 0 for one in self.optima)

    @property
    def unseen(self) -> float:
        """The expected share of starts that lead to optima not seen yet: `w (w + 1) / (n (n - 1))`.

        For `w` optima seen from `n` uniform random starts (Boender and Rinnooy Kan 1987). 1 for too few starts to say
        anything: fewer than six, or than three more than optima.
        """
        w, n = self.seen_at_random, self.solved
        return w * (w + 1) / (n * (n - 1)) if self._is_telling else 1.0

    @property
    def _is_telling(self) -> bool:
        """Whether there are random starts enough to conclude from."""
        return self.solved >= max(_FEWEST, self.seen_at_random + _MORE)

    def sure(self) -> str:
        """How sure one may be that no design is better, in words."""
        if self.proven:
            return "No design is better: the objective is at its lower bound."
        best = self.optima[0] if self.optima else None
        if best is None or not self._is_telling:
            return (
                f"Too few random starts ended at an optimum to say how many others there are: {self.solved}, at "
                f"{self.seen_at_random} optima. Nothing can be said of designs not seen; take more starts."
            )
        found = f"{best.random} of {self.solved} random starts" if best.random else "Only the global search"
        return (
            f"{found} led to the best one; a further random start would lead to an optimum not seen yet with a "
            f"probability of about {self.unseen:.0%} (Boender and Rinnooy Kan 1987)."
        )

    def __str__(self) -> str:
        rows = [f"{one.objective:14.8g}  from {one.starts} of {self.starts} starts" for one in self.optima]
        failed = self.starts - sum(one.starts for one in self.optima)
        return "\n".join(
            [
                "local optima (equal objectives count as one)",
                *rows,
                *([f"{failed} starts ended at none"] if failed else []),
                *([str(self.searched)] if self.searched else []),
                f"best: {self.best.objective:.8g}, {self.best.status.value}",
                *(["interrupted by the user"] if self.interrupted else []),
                self.sure(),
            ]
        )


class _Start(NamedTuple):
    point: Float[np.ndarray, " n"]
    is_random: bool


class _End(NamedTuple):
    outcome: Outcome
    is_random: bool


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
    one_of("portfolio: problem", problem, Problem)
    starts, seed = whole("portfolio: starts", starts), whole("portfolio: seed", seed, least=0)
    check_executor("portfolio", executor)
    check_progress("portfolio", progress)
    if search is not None:
        one_of("portfolio: search", search, AbstractSearch, "al.solvers.DifferentialEvolution(), or None")
        check_search("portfolio", problem, search, "search=None leaves the global search out.")
    local = solver or DEFAULT.solver
    one_of("portfolio: solver", local, AbstractSolver, "al.solvers.FilterSQP()")
    program = transcribe(problem, DEFAULT).program
    ended: dict[int, _End] = {}
    found: Sequence[Float[np.ndarray, " n"]] = []
    searched: Searched | None = None
    with until_interrupted(lambda: ended or found) as steps:
        if search is not None:
            found_by = searched_globally(problem, program, search, max(starts // 2, 1), executor)
            found, searched = found_by.candidates, found_by.searched
            steps.heed(found_by.status)
        begun = list(_starts(program, found, starts, seed))
        progress("local searches", 0, starts)
        points = [one.point for one in begun]
        for i, outcome in each_outcome(problem, program, local.local, points, executor):
            if outcome.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            ended[i] = _End(outcome, begun[i].is_random)
            progress("local searches", len(ended), starts)
            steps.heed()
    ends = [ended[i] for i in sorted(ended)]
    optima = _optima(problem, ends)
    points = _worth_certifying(optima, ends, found)
    try:
        best = _certified(problem, local.local, search, points)
    except KeyboardInterrupt:
        # Here Ctrl-C ends the comparison, not the certificate, without which there would be no result.
        steps.interrupted = True
        best = _certified(problem, local.local, search, points[:1])
    return Portfolio(
        best=best,
        optima=tuple(one for one, _ in optima),
        starts=len(ends),
        random=sum(one.is_random for one in ends),
        solved=sum(one.is_random and one.outcome.ok for one in ends),
        searched=searched,
        proven=best.ok and _is_least(program, best.objective, local.tolerance),
        interrupted=steps.interrupted,
    )


def _starts(
    program: NonlinearProgram, found: Sequence[Float[np.ndarray, " n"]], count: int, seed: int
) -> Iterator[_Start]:
    """The points that a search found, then the program's own start, then random ones, `count` in all."""
    lower, upper = variable_range(program.start, program.lower, program.upper, program.variable_scale)
    generator = np.random.default_rng(seed)
    own = [*found, program.start][:count]
    yield from (_Start(one, is_random=False) for one in own)
    for _ in range(count - len(own)):
        yield _Start(generator.uniform(lower, upper), is_random=True)


def _optima(problem: Problem, ends: Sequence[_End]) -> list[tuple[Optimum, Float[np.ndarray, " n"]]]:
    """The different optima, best first, with their points."""
    solved = sorted((one for one in ends if one.outcome.ok), key=lambda one: one.outcome.evaluation.objective)
    size = np.max(np.abs([one.outcome.point for one in solved]), axis=0, initial=1e-12) if solved else np.zeros(0)
    none = _NONE * _at_starts(ends)
    groups: list[list[_End]] = []
    for one in solved:
        if groups and _is_same(groups[-1][0].outcome, one.outcome, size, none):
            groups[-1].append(one)
        else:
            groups.append([one])
    optima = []
    for group in groups:
        best = group[0].outcome
        named, random = problem.placements.named(best.point), sum(one.is_random for one in group)
        optima.append((Optimum(best.evaluation.objective, named, len(group), random), best.point))
    return optima


def _at_starts(ends: Sequence[_End]) -> float:
    """The middle magnitude of the objective at the starts of local searches."""
    first = [one.outcome.visited.objectives[:1] for one in ends if one.outcome.visited is not None]
    known = np.abs(np.concatenate([np.zeros(0), *first]))
    known = known[np.isfinite(known)]
    return float(np.median(known)) if known.size else 0.0


def _is_same(one: Outcome, other: Outcome, size: Float[np.ndarray, " n"], none: float) -> bool:
    """Mirrored designs count as one, by their objective, and so do equal designs."""
    first, second = one.evaluation.objective, other.evaluation.objective
    close = abs(first - second) <= max(_SAME * max(abs(first), abs(second)), none)
    return bool(close or np.all(np.abs(one.point - other.point) < _SAME * size))


def _is_least(program: NonlinearProgram, objective: float, tolerance: float) -> bool:
    """Whether an objective is at its lower bound, as far as can be told beside its fall from the start."""
    above = program.evaluate(program.start).objective - program.least
    return bool(np.isfinite(program.least)) and bool(objective - program.least <= tolerance * above)


def _worth_certifying(
    optima: Sequence[tuple[Optimum, Float[np.ndarray, " n"]]],
    ends: Sequence[_End],
    found: Sequence[Float[np.ndarray, " n"]],
) -> list[Float[np.ndarray, " n"]]:
    """The best optima; without any, the least violated design, or the best one of the search."""
    if optima:
        return [point for _, point in optima[:_CERTIFIED]]
    if ends:
        return [min(ends, key=lambda one: np.nan_to_num(one.outcome.violation, nan=np.inf)).outcome.point]
    return list(found[:1])


def _certified(
    problem: Problem,
    solver: AbstractSolver,
    search: AbstractSearch | None,
    points: Sequence[Float[np.ndarray, " n"]],
) -> Solution:
    """The first of some points whose certificate stands, else the first one."""
    found: list[Solution] = []
    for point in points:
        start = problem.placements.named(point)
        with warned_of("portfolio"):
            try:
                found.append(solve(problem, solver, start=start, throw=False))
            except ProblemError:
                if search is None:
                    raise
                # Derivatives cannot choose, but values have: the point is judged as the answer of a search of one.
                found.append(solve(problem, replace(search, evaluations=1), start=start, throw=False))
        if found[-1].ok:
            return found[-1]
    return found[0]


@final
@dataclass(frozen=True)
class FoundGlobally:
    """What a global search found: points that lie apart, best first, and its history.

    - `status`: `Status.INTERRUPTED` if the user ended it.
    """

    candidates: list[Float[np.ndarray, " n"]]
    searched: Searched
    status: Status


def searched_globally(
    problem: Problem, program: NonlinearProgram, search: AbstractSearch, count: int, executor: Executor | None
) -> FoundGlobally:
    """At most `count` points of a global search; from a journal, if one has them.

    An executor finds the values of whole generations, not those of one point after the other.
    """

    def found() -> FoundGlobally:
        sought, searched = search.seek(valued_by(executor if search.at_once else None, program, "portfolio"))
        status = Status.SOLVED if sought.halt is None else Status.INTERRUPTED
        return FoundGlobally(sought.candidates(count), searched, status)

    given = {"problem": problem, "search": replace(search, progress=silent), "count": count}
    return journalled("global search", given, found)


def each_outcome(
    problem: Problem,
    program: NonlinearProgram,
    solver: AbstractSolver,
    points: Sequence[Float[np.ndarray, " n"]],
    executor: Executor | None,
) -> Iterator[tuple[int, Outcome]]:
    """The outcome of a local search from each point, with its index; by an executor as soon as it is there."""
    if executor is not None:
        yield from _by(executor, problem, solver, points)
        return
    for i, point in enumerate(points):
        yield i, journalled("local search", _given(problem, solver, point), lambda: solver.solve(program, start=point))  # noqa: B023 -- called at once


def _by(
    executor: Executor, problem: Problem, solver: AbstractSolver, points: Sequence[Float[np.ndarray, " n"]]
) -> Iterator[tuple[int, Outcome]]:
    entries = [entry_of("local search", _given(problem, solver, point)) for point in points]
    yield from ((i, entry.recalled) for i, entry in enumerate(entries) if entry.recalled is not None)
    missing = [i for i, entry in enumerate(entries) if entry.recalled is None]
    calls = [{"problem": problem, "solver": solver, "point": points[i]} for i in missing]
    places = [f"portfolio, local search {i + 1}" for i in missing]
    for number, outcome in each_done(executor, _searched_there, calls, places):
        entries[missing[number]].keep(outcome)
        yield missing[number], outcome


def _searched_there(problem: Problem, solver: AbstractSolver, point: Float[np.ndarray, " n"]) -> Outcome:
    refuse_other_code(problem)
    return solver.solve(transcribe(problem, DEFAULT).program, start=point)


def _given(problem: Problem, solver: AbstractSolver, point: Float[np.ndarray, " n"]) -> dict[str, Any]:
    return {"problem": problem, "solver": solver, "start": point}
