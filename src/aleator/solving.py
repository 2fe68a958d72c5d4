"""`solve`: the stages of a solution, in order."""

import functools
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from aleator._core.beside import dropped_on_failure
from aleator._core.errors import ExpansionWarning, GridWarning, ProblemError, SimulationError, SolveError
from aleator._core.given import one_of, whole
from aleator._core.heard import heeding
from aleator.certification import (
    REACHED,
    Reference,
    diagnose,
    doubts,
    grid_error,
    held_at_worst,
    held_between,
    prepare_judges,
    probed,
    reference_factor,
    refinement,
    second_opinion,
    solution_of,
    unconverged,
    untrusted,
    whether_misled,
)
from aleator.design import Problem, deterministic, is_over_time
from aleator.nlp import AbstractSolver, Outcome, Status, feasible_elsewhere, moved_on
from aleator.solution import TOLERATED, AtMeans, Between, Solution, WorstCase
from aleator.transcription import (
    DEFAULT,
    AbstractTranscribed,
    AbstractTranscription,
    refuse_blind,
    started_from,
    transcribe,
)

# Ends of a search that a grid which is far off may have led astray.
_UNSOLVED = (Status.INFEASIBLE, Status.FAILED, Status.ITERATION_LIMIT)
# Ends of the deterministic problem that start nothing.
_NO_START = (*_UNSOLVED, Status.EVALUATION_FAILED)
# The finest accuracy of a grid that may be asked for.
_FINEST = 1e-9


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
    refine: bool = False,
    throw: bool = True,
) -> Solution:
    """Solve a design problem: transcribe, compile once, optimise with exact derivatives, certify.

    - `solver`: `al.solvers.FilterSQP()` by default; `Ipopt()` or `Slsqp()` for a second opinion;
    - `transcription`: how the problem becomes a nonlinear program: `Sequential()` by default;
    - `warm_start`: a solution of the same problem to start from, on the same grid or another, with as many control
      points of its trajectories or others: curves are refitted over the fraction of time, other decisions are taken
      over by name. Where states are variables, they start from its own too, in the place of a guess;
    - `start`: values of decisions by name to start from, in the place of their own initial ones;
    - `deterministic_first`: solve the problem with every distribution held at its mean first, and start from that: from
      its decisions and, where states are variables, the states. For problems that are hard to start: a way for one
      system is found sooner than for many. `solution.effort.at_means` tells how that ended;
    - `between`: limits over time are checked on a grid of so many times as many steps as well, and where they are
      exceeded between two instants, the bounds there are tightened until they hold; a solution that exceeds one by more
      than a thousandth of it nevertheless has failed. 1 leaves that out. By default 10 for systems that follow
      trajectories, 2 for others, or more on a coarse grid;
    - `accuracy`: the error of the grid that is tolerated, as a part of a limit or of a spread, whichever is smaller. It
      is told by a finer grid and an integrator of another order. A solution whose objective is off by more than this
      part of it, or that breaks a limit on the finer grid, is not `ok`; other errors beyond it are warned of;
    - `refine`: solve again on finer grids, each from the last solution, until the error is tolerated. The solution's
      problem then has the finest grid;
    - `throw`: if False, a solution that failed is returned with its status instead of raised.

    Raises `SolveError` (which carries the unfinished solution), `SimulationError` if the model gives numbers that are
    not finite, `ProblemError` if there is nothing to decide. Warns with `ExpansionWarning` if an expansion is not
    resolved (where it is too coarse for a statistic that is asked of it, the solution has failed: a tail beyond the
    expansion's tolerance, a spread by more than a third of itself), or if a few fresh simulations at the answer
    contradict it (where that breaks a limit, the solution has failed: see `SecondOpinion`), with `GridWarning` if the
    grid is too coarse.
    """
    one_of("solve: transcription", transcription, AbstractTranscription, "al.Sequential()")
    solver = solver or transcription.solver
    _check_arguments(problem, solver, warm_start, deterministic_first, between, accuracy)
    transcription = transcription if warm_start is None else transcription.starting_from(warm_start)
    first = _first(problem, transcription, warm_start, start)
    known = (None, None) if warm_start is None else (warm_start.multipliers, warm_start.certificate.worst_case)
    # Ctrl-C may be lost where Python cannot raise: in a callback of the garbage collector, of which JAX has one.
    with heeding() as heed, dropped_on_failure():
        stages = _Stages(transcription, solver, between, float(accuracy), _compile_seconds(transcription), heed)
        stages, first, at_means = _from_means(stages, problem, first) if deterministic_first else (stages, first, None)
        answer = stages.answer(problem, first, *known)
        if refine:
            answer = _refined(stages, answer)
        solution = _with_opinion(stages, answer)
        solution = replace(solution, effort=replace(solution.effort, at_means=at_means))
        heed()
    if throw and solution.status is Status.EVALUATION_FAILED:
        raise SimulationError(solution.message)
    if throw and not solution.ok:
        raise SolveError(solution.why(), solution)
    _warn_of_doubts(solution)
    _warn_if_coarse(solution)
    return solution


class _Answer(NamedTuple):
    """A solution, the program that it was found by, and the point of that program that it stands for."""

    solution: Solution
    transcribed: AbstractTranscribed
    point: np.ndarray


class _Meshed(NamedTuple):
    """A problem on the last of its meshes: where it is to start, and its outcome there if it has been solved."""

    transcribed: AbstractTranscribed
    begun: np.ndarray | None
    outcome: Outcome | None


class _Stages(NamedTuple):
    """The stages of one solution, the same on each grid."""

    transcription: AbstractTranscription
    solver: AbstractSolver
    between: int | None
    accuracy: float
    compiled_before: float
    heed: Callable[[], None]

    @property
    def compiled(self) -> float:
        """How long compilations have taken since the first stage, s."""
        return _compile_seconds(self.transcription) - self.compiled_before

    def answer(
        self,
        problem: Problem,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
        known: WorstCase | None = None,
    ) -> _Answer:
        """Optimise, hold limits between the instants and in the worst case, find the error of the grid, report.

        `start`: decisions, None for their own initial values.
        """
        is_between = self.between != 1 and any(map(is_over_time, problem.constraints))
        factor = reference_factor(problem, self.between)
        transcribed = transcribe(problem, self.transcription, functools.partial(prepare_judges, factor))
        self.heed()
        begun = None if start is None else transcribed.point(start)
        meshed = self._meshed(transcribed, begun) if self.transcription.refines else _Meshed(transcribed, begun, None)
        transcribed, begun, _ = meshed
        factor = reference_factor(transcribed.problem, self.between)
        is_judged = multipliers is None and not self.transcription.is_guessed
        astray = self._astray(transcribed, begun, factor) if is_judged else lambda: ""
        transcribed, outcome, (between, finer), worst_case = held_at_worst(
            transcribed,
            functools.partial(self._attempt, meshed),
            begun,
            multipliers,
            factor=factor if is_between else 1,
            known=known,
        )
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if outcome.failed_at is not None:
            outcome = replace(outcome, message=diagnose(transcribed, transcribed.decisions(outcome.failed_at)))
        error = None
        at_start = astray() if finer is not None or outcome.status in _UNSOLVED else ""
        if finer is not None:
            elsewhere = probed(transcribed, outcome.point, finer)
            error = grid_error(transcribed, outcome.point, finer, self.accuracy, elsewhere.numbers)
            error = replace(error, at_start=at_start)
            if between is not None and elsewhere.worst > between.worst:
                between = replace(between, worst=elsewhere.worst, name=elsewhere.where, time=elsewhere.when)
        if error is not None and not error.is_usable:
            outcome = replace(outcome, status=Status.COARSE)
        if between is not None and between.worst > TOLERATED:
            outcome = replace(outcome, status=Status.NOT_HELD)
        misled = at_start if outcome.status in _UNSOLVED else ""
        found = solution_of(transcribed, outcome, between, error, worst_case, misled, self.compiled)
        return _Answer(found, transcribed, outcome.point)

    def _meshed(self, transcribed: AbstractTranscribed, begun: np.ndarray | None) -> _Meshed:
        """The problem on a mesh that is fine enough, and its outcome; where one fails, it stays."""
        while True:
            self.heed()
            outcome = _optimise(transcribed, self.solver, begun, None)
            if outcome.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            finer = transcribed.refined(outcome.point) if outcome.status is Status.SOLVED else None
            if finer is None:
                return _Meshed(transcribed, outcome.point if outcome.status is Status.SOLVED else begun, outcome)
            transcribed, begun = finer

    @staticmethod
    def _astray(transcribed: AbstractTranscribed, start: np.ndarray | None, factor: int) -> Callable[[], str]:
        """Whether the search begins where the grid is far off, found out while it runs."""
        begun = transcribed.program.start if start is None else start
        transcribed.prepare_resolution(begun)
        return whether_misled(transcribed, begun, factor)

    def _attempt(
        self,
        meshed: _Meshed,
        transcribed: AbstractTranscribed,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
    ) -> tuple[Outcome, tuple[Between | None, Reference | None]]:
        self.heed()
        known = meshed.outcome if transcribed is meshed.transcribed else None
        outcome = _optimise(transcribed, self.solver, start, multipliers) if known is None else known
        if multipliers is None:
            outcome = _looked_around(transcribed, self.solver, outcome, start)
        self.heed()
        outcome, between, finer = held_between(transcribed, self.solver, outcome, self.between)
        return outcome, (between, finer)


def _compile_seconds(transcription: AbstractTranscription) -> float:
    """How long all compilations that a solution waits for have taken so far, s."""
    return transcription.compile_seconds() + REACHED.seconds


def _from_means(
    stages: _Stages, problem: Problem, first: np.ndarray | None
) -> tuple[_Stages, np.ndarray | None, AtMeans | None]:
    """The stages and the decisions that start from the answer to the deterministic problem, if it has one."""
    if not problem.placements.germs:
        return stages, first, None
    try:
        mean = stages._replace(between=1).answer(deterministic(problem), first, None).solution
    except ProblemError:
        # Without spreads a limit may be impossible that the problem itself can meet. What is wrong with both is told by
        # the problem itself.
        return stages, first, AtMeans(Status.INFEASIBLE, starts=False, iterations=0, evaluations=0)
    starts = mean.status not in _NO_START
    at_means = AtMeans(mean.status, starts, mean.effort.iterations, mean.effort.evaluations)
    if not starts:
        return stages, first, at_means
    stages = stages._replace(transcription=stages.transcription.starting_from(mean))
    # Controls on a refined mesh have more values than the problem's.
    return stages, started_from(problem, mean), at_means


def _refined(stages: _Stages, answer: _Answer) -> _Answer:
    """The answer on finer grids, until the error is tolerated or does not fall any more."""
    solutions = [answer.solution]
    while (plan := refinement(solutions)) is not None:
        stages = stages._replace(transcription=stages.transcription.starting_from(solutions[-1]))
        answer = stages.answer(plan, solutions[-1].vector, None)
        solutions.append(answer.solution)
    reason = unconverged(solutions)
    return answer._replace(solution=replace(answer.solution, message=reason)) if reason else answer


def _with_opinion(stages: _Stages, answer: _Answer) -> Solution:
    """The solution with what a few fresh simulations say of its expansions, and failed where they break a limit, or
    where an expansion is too coarse for what is asked of it.
    """
    solution = answer.solution
    if not solution.ok:
        return solution
    opinion = second_opinion(answer.transcribed, answer.point)
    coarse = untrusted(solution.problem, solution.certificate.expansion)
    status = Status.UNRESOLVED if coarse else solution.status
    if opinion is not None and opinion.broken:
        status = Status.CONTRADICTED
    return replace(
        solution,
        status=status,
        message=coarse or solution.message,
        certificate=replace(solution.certificate, opinion=opinion),
        effort=replace(solution.effort, times=replace(solution.effort.times, compile_=stages.compiled)),
    )


def _check_arguments(
    problem: Problem,
    solver: AbstractSolver,
    warm_start: Solution | None,
    deterministic_first: bool,
    between: int | None,
    accuracy: float,
) -> None:
    if not isinstance(problem, Problem):
        raise ProblemError(f"solve: expected a Problem; received {type(problem).__name__}.")
    if not isinstance(solver, AbstractSolver):
        raise ProblemError(f"solve: expected a solver, such as al.solvers.Ipopt(); received {solver!r}.")
    if between is not None:
        whole("solve: between", between)
    if isinstance(accuracy, bool) or not isinstance(accuracy, int | float) or not _FINEST <= accuracy < 1:
        raise ProblemError(
            f"solve: expected `accuracy` as a number from {_FINEST:g} (64-bit arithmetic gives no more) to below 1; "
            f"received {accuracy!r}."
        )
    if not isinstance(deterministic_first, bool):
        raise ProblemError(f"solve: expected True or False as `deterministic_first`; received {deterministic_first!r}.")
    if warm_start is None:
        return
    if deterministic_first:
        raise ProblemError(
            "solve: expected either `warm_start` or `deterministic_first`, for each says where to start; received both."
        )
    if not isinstance(warm_start, Solution):
        raise ProblemError(f"solve: expected a Solution as `warm_start`; received {type(warm_start).__name__}.")
    if warm_start.problem.names != problem.names:
        raise ProblemError(
            "solve: a warm start is a solution of a problem with the same constraints; expected "
            f"{list(problem.names)}; received {list(warm_start.problem.names)}."
        )


def _first(
    problem: Problem,
    transcription: AbstractTranscription,
    warm_start: Solution | None,
    start: Mapping[str, Any] | None,
) -> np.ndarray | None:
    """The decisions to start from; None for their own initial values."""
    places = problem.placements
    if start is None:
        return None if warm_start is None else started_from(problem, warm_start)
    # What is given is checked first.
    moved = places.moved(transcription.first(problem) if warm_start is None else places.vector("initial"), start)
    return moved if warm_start is None else places.moved(started_from(problem, warm_start, start), start)


def _optimise(
    transcribed: AbstractTranscribed, solver: AbstractSolver, start: np.ndarray | None, multipliers: np.ndarray | None
) -> Outcome:
    rows = transcribed.program.constraint_lower.shape
    # Multipliers at the instants of another grid say nothing here.
    known = multipliers if multipliers is not None and multipliers.shape == rows else None
    return solver.solve(transcribed.program, start=start, multipliers=known)


def _looked_around(
    transcribed: AbstractTranscribed, solver: AbstractSolver, outcome: Outcome, start: np.ndarray | None
) -> Outcome:
    """The outcome of a start of which nothing is known, or a better one found by points elsewhere."""
    program = transcribed.program
    begun = program.start if start is None else start
    outcome = feasible_elsewhere(program, outcome, begun, lambda other, first: solver.solve(other, start=first))
    outcome = moved_on(program, outcome, begun, lambda first: solver.solve(program, start=first))
    refuse_blind(outcome, transcribed)
    return outcome


def _warn_of_doubts(solution: Solution) -> None:
    found = solution.certificate
    sentences = [] if solution.status is Status.EVALUATION_FAILED else doubts(found.expansion, found.opinion)
    if sentences:
        warnings.warn(f"{'. '.join(sentences)}, and compare with al.validate.", ExpansionWarning, stacklevel=3)


def _warn_if_coarse(solution: Solution) -> None:
    if solution.ok and not all(one.is_met for one in solution.meshes[-1:]):
        warnings.warn(
            f"The mesh does not reach the error that was asked for: {solution.meshes[-1]}. If the model jumps in time "
            "there, let the jump fall on an instant of the grid or make it smooth; or ask for less.",
            GridWarning,
            stacklevel=3,
        )
    error = solution.certificate.grid_error
    if error is not None and solution.ok and not error.is_met:
        warnings.warn(f"On {error.steps} steps {error}.", GridWarning, stacklevel=3)
