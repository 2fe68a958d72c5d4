"""`solve`: its arguments, and the whole of a solution, stage by stage."""

import warnings
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from aleator._core.border import one_of, refusal, whole
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError, SimulationError, SolveError
from aleator._core.executors import check_executor
from aleator._core.journalled import journalled
from aleator._core.parallel import dropped_on_failure, heeding, one_thread_of_blas
from aleator.certification._grids import refinement
from aleator.certification._judgement import Held, doubts, with_opinion
from aleator.design import Problem, deterministic
from aleator.nlp import AbstractSearch, AbstractSolver, Status
from aleator.solution import Solution
from aleator.solving._integers import branched
from aleator.solving._intervals import robust
from aleator.solving._search import Search
from aleator.solving._stages import Stages
from aleator.transcription import DEFAULT, AbstractTranscription, started_from
from aleator.uncertainty import intervals_of, tables_of

# The finest accuracy of a grid that may be asked for.
_FINEST = 1e-9
# Finer grids that may replace bounds beside jumps; on the next one tightened bounds have to hold limits there.
_MOST_FINER = 2


class Call(NamedTuple):
    """Arguments of `solve`."""

    problem: Problem
    solver: AbstractSolver | None = None
    transcription: AbstractTranscription = DEFAULT
    warm_start: Solution | None = None
    start: Mapping[str, Any] | None = None
    deterministic_first: bool = False
    between: int | None = None
    accuracy: float = 1e-3
    refine: bool | None = None
    executor: Executor | None = None

    @property
    def chosen_solver(self) -> AbstractSolver:
        """That of the call, or of its transcription."""
        return self.transcription.solver if self.solver is None else self.solver

    @property
    def causes(self) -> dict[str, Any]:
        """All that its answer follows from, by name: all arguments but the executor."""
        start = dict(self.start) if isinstance(self.start, Mapping) else self.start
        return self._replace(solver=self.chosen_solver, start=start, executor=None)._asdict()


def check_arguments(call: Call) -> None:
    """Raise `ProblemError` unless the arguments are what `solve` expects."""
    problem, solver, warm_start, accuracy = call.problem, call.chosen_solver, call.warm_start, call.accuracy
    one_of("solve: problem", problem, Problem)
    one_of("solve: solver", solver, AbstractSolver, "al.solvers.Ipopt()")
    one_of("solve: deterministic_first", call.deterministic_first, bool)
    if call.between is not None:
        whole("solve: between", call.between)
    if call.refine is not None:
        one_of("solve: refine", call.refine, bool)
    if isinstance(accuracy, bool) or not isinstance(accuracy, int | float) or not _FINEST <= accuracy < 1:
        raise refusal("solve: accuracy", f"a number from {_FINEST:g} (64-bit arithmetic gives no more) to 1", accuracy)
    if isinstance(solver, AbstractSearch):
        check_search("solve", problem, solver)
    check_executor("solve", call.executor)
    if call.executor is not None and not (isinstance(solver, AbstractSearch) and solver.at_once):
        raise ProblemError(
            "solve: executor: expected a solver that evaluates many designs at once, such as "
            f"al.solvers.DifferentialEvolution(); received {type(solver).__name__}. al.multistart, al.portfolio and "
            "al.pareto share several solves."
        )
    if warm_start is None:
        return
    if call.deterministic_first:
        raise ProblemError("solve: expected either `warm_start` or `deterministic_first`; received both.")
    if one_of("solve: warm_start", warm_start, Solution).problem.names != problem.names:
        raise ProblemError(
            "solve: a warm start is a solution of a problem with the same constraints; expected "
            f"{list(problem.names)}; received {list(warm_start.problem.names)}."
        )


def check_search(
    what: str, problem: Problem, solver: AbstractSearch, remedy: str = "al.solvers.NelderMead() needs none."
) -> None:
    """Refuse, by name, what a search without derivatives cannot decide or hold."""
    places, who = problem.placements, type(solver).__name__
    lower, upper = places.vector("lower"), places.vector("upper")
    if solver.needs_bounds and not (closed := np.isfinite(lower) & np.isfinite(upper)).all():
        name = places.entry_names()[int(np.flatnonzero(~closed)[0])]
        if name.endswith(".excess"):
            remedy = "al.soft(..., exact=True, most=...) bounds a slack."
        raise ProblemError(
            f"{what}: {who} searches between bounds: expected finite bounds of every decision; '{name}' has none on at "
            f"least one side. {remedy}"
        )
    equal = [one for one in problem.constraints if float(one.lower) == float(one.upper)]
    if equal and not solver.polish:
        raise ProblemError(
            f"{what}: {who} without polishing cannot hold an equality: expected limits alone, or polish=True; received "
            f"'{equal[0].name}' ({equal[0]})."
        )


def solve(
    problem: Problem,
    solver: AbstractSolver | None = None,
    *,
    transcription: AbstractTranscription = DEFAULT,
    warm_start: Solution | None = None,
    start: Mapping[str, Any] | None = None,
    deterministic_first: bool = False,
    between: int | None = None,
    accuracy: float = 1e-3,
    refine: bool | None = None,
    executor: Executor | None = None,
    throw: bool = True,
) -> Solution:
    """Solve a design problem: transcribe, compile once, optimise with exact derivatives, certify.

    Where decisions are `al.Integer` or `al.Choice`, the best combination is sought by branch and bound, and
    `solution.branching` tells what is known of the others.

    - `solver`: `al.solvers.FilterSQP()` by default; `Ipopt()` or `Slsqp()` for a second opinion; a search without
      derivatives, such as `DifferentialEvolution()`, where there may be several optima, which is then polished;
    - `transcription`: how the problem becomes a nonlinear program: `Sequential()` by default;
    - `warm_start`: a solution of the same problem to start from, on the same grid or another, with as many control
      points of its trajectories or others: curves are refitted over the fraction of time, other decisions are taken
      over by name. Where states are variables, they start from its own too, instead of a guess;
    - `start`: values of decisions by name to start from, instead of their own initial ones;
    - `deterministic_first`: start from the decisions and states of the answer with every distribution at its mean, a
      way for one system being found sooner than for many. `solution.effort.at_means` tells whether there was one;
    - `between`: limits over time are held between the instants too, as seen on a grid of so many times as many steps;
      a solution that exceeds one there by more than a thousandth has failed. 1 leaves that out. By default 11 for
      systems that follow trajectories, 3 for others, or more on a coarse grid; the next odd prime number is taken;
    - `accuracy`: the error of the grid that is tolerated, as a part of a limit or of a spread, whichever is smaller. A
      solution whose objective is off by more than this part of it, or that breaks a limit on a finer grid, has failed;
      other errors beyond it are warned of;
    - `refine`: solve again on finer grids, each from the last solution, until the error is tolerated. The solution's
      problem then has the finest grid. By default only where limits over time need one: where they break between the
      instants of this grid, or hold by bounds that cost more than a twentieth of the objective. False keeps the grid;
    - `executor`: simulates the generations of a search without derivatives (see `al.pareto`), with the same result;
    - `throw`: if False, a solution that failed is returned with its status instead of raised.

    Raises `SolveError` (which carries the unfinished solution), `SimulationError` if the model gives numbers that are
    not finite, `ProblemError` if there is nothing to decide. Warns with `ExpansionWarning` if an expansion is not
    resolved or fresh simulations contradict it, with `GridWarning` if the grid is too coarse: see `Certificate`.
    """
    one_of("solve: transcription", transcription, AbstractTranscription, "al.Sequential()")
    each = problem, solver, transcription, warm_start, start, deterministic_first, between, accuracy, refine, executor
    call = Call(*each)
    check_arguments(call)
    solution = journalled("solve", call.causes, lambda: _solved(call))
    if throw and solution.status is Status.EVALUATION_FAILED:
        raise SimulationError(solution.message)
    if throw and not solution.ok:
        raise SolveError(solution.why(), solution)
    for kind, text in doubts(solution):
        warnings.warn(f"{text[0].upper()}{text[1:]}.", kind, stacklevel=2)
    return solution


def _solved(call: Call) -> Solution:
    """The solution, whatever its status: see `solve`."""
    if not tables_of(call.problem.placements):
        return _solved_at_once(call)

    def full(problem: Problem, start: Mapping[str, Any]) -> Solution:
        return _solved_at_once(call._replace(problem=problem, start=start))

    search = Search(call.chosen_solver, call.executor, lambda: None)
    return branched(call.problem, call.transcription, search, _first(call, call.transcription), full)


def _first(call: Call, transcription: AbstractTranscription) -> np.ndarray | None:
    """The decisions to start from; None for their own initial values."""
    problem, warm, places = call.problem, call.warm_start, call.problem.placements
    first = None
    if call.start is not None:  # What the user says is checked first.
        first = places.moved(transcription.first(problem) if warm is None else places.vector("initial"), call.start)
    if warm is not None:
        first = started_from(problem, warm, call.start or ())
        first = first if call.start is None else places.moved(first, call.start)
    return first


def _solved_at_once(call: Call) -> Solution:
    """The solution of a problem whose decisions may have any value between their bounds."""
    problem, warm, transcription = call.problem, call.warm_start, call.transcription
    transcription = transcription if warm is None else transcription.starting_from(warm)
    first, before = _first(call, transcription), Compiled.seconds
    known = (None, None) if warm is None else (warm.multipliers, warm.certificate.worst_case)
    # Ctrl-C may be lost where Python cannot raise: in a callback of the garbage collector, of which JAX has one.
    with heeding() as heed, dropped_on_failure(), one_thread_of_blas():
        search = Search(call.chosen_solver, call.executor, heed)
        stages = Stages(transcription, search, call.between, call.accuracy, keeps_grid=call.refine is False)
        at_means = None
        if call.deterministic_first and problem.placements.germs:
            stages, first, at_means = _from_means(stages, problem, first)
        solution, held = _answer(stages, problem, first, *known)
        solutions = [solution]
        while call.refine is not False and (plan := refinement(solutions, between=not call.refine)) is not None:
            start_from = stages.transcription.starting_from(solution)
            stages = stages._replace(transcription=start_from, keeps_grid=len(solutions) >= _MOST_FINER)
            further, with_further = _answer(stages, plan, solution.vector)
            if solution.ok and not (further.ok or call.refine):
                break
            solution, held = further, with_further
            solutions.append(solution)
        solution = solution if held is None else with_opinion(solution, held)
        times = replace(solution.effort.times, compile_=Compiled.seconds - before)
        solution = replace(solution, effort=replace(solution.effort, at_means=at_means, times=times))
        heed()
    return solution


def _answer(stages: Stages, problem: Problem, first: np.ndarray | None, *known: Any) -> tuple[Solution, Held | None]:
    """The solution of a problem on its grid, and what has yet to be asked for an opinion of fresh systems."""
    if intervals_of(problem.placements):
        return robust(stages, problem, first), None
    return stages.answer_in_elements(problem, first, *known)


def _from_means(stages: Stages, problem: Problem, first: np.ndarray | None) -> tuple[Stages, np.ndarray | None, bool]:
    """The stages and the decisions that start from the answer to the deterministic problem, and whether it has one."""
    try:
        mean, _ = _answer(stages._replace(between=1), deterministic(problem), first)
    except ProblemError:
        # Without spreads a limit may be impossible that the problem itself can meet. What is wrong with both is told by
        # the problem itself.
        return stages, first, False
    if mean.status not in (Status.SOLVED, Status.INTERRUPTED):
        return stages, first, False
    # Controls on a refined mesh have more values than the problem's.
    stages = stages._replace(transcription=stages.transcription.starting_from(mean))
    return stages, started_from(problem, mean), True
