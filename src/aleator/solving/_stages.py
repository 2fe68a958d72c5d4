"""The stages of one solution: transcribe, refine the mesh, optimise, hold limits, judge the grid."""

import functools
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aleator._core.compilation import Compiled
from aleator.certification import (
    Check,
    begin_check,
    check_factor,
    diagnose,
    grid_error,
    held_at_worst,
    held_between,
    misled_at,
    moved_correlations,
    prepare_check,
    second_opinion,
    solution_of,
    untrusted,
)
from aleator.design import Problem, is_over_time
from aleator.nlp import AbstractSearch, AbstractSolver, Outcome, Status, restart_of
from aleator.solution import Between, Solution, WorstCase
from aleator.transcription import (
    AbstractTranscribed,
    AbstractTranscription,
    blind_decisions,
    refuse_blind,
    transcribe,
    valued_by,
)

UNSOLVED = (Status.INFEASIBLE, Status.FAILED, Status.ITERATION_LIMIT)
"""Ends of a search that a grid which is far off may have led astray."""

# How often an answer is left for a better one at most.
_MOST_RESTARTS = 8


class Answer(NamedTuple):
    """A solution, the program that it was found by, the point of that program that it stands for, and its check."""

    solution: Solution
    transcribed: AbstractTranscribed
    point: np.ndarray
    check: Check | None

    def with_opinion(self) -> Solution:
        """The solution with what fresh systems say of its expansions, unless its grid is no good already."""
        solution, problem = self.solution, self.solution.problem
        if not solution.ok:
            return solution
        certificate = replace(
            solution.certificate,
            opinion=None if self.check is None else second_opinion(self.transcribed, self.point, self.check),
            untrusted=untrusted(problem, solution.certificate.expansion),
            correlations=moved_correlations(problem, solution.vector),
        )
        return replace(solution, certificate=certificate)


class _Meshed(NamedTuple):
    """A problem on the last of its meshes: where it is to start, and its outcome there if it has been solved."""

    transcribed: AbstractTranscribed
    begun: np.ndarray | None
    outcome: Outcome | None


class Stages(NamedTuple):
    """The stages of one solution, the same on each grid."""

    transcription: AbstractTranscription
    solver: AbstractSolver
    between: int | None
    accuracy: float
    compiled_before: float
    heed: Callable[[], None]
    executor: Executor | None

    @property
    def compiled(self) -> float:
        """How long compilations have taken since the first stage, s."""
        return Compiled.seconds - self.compiled_before

    def answer(
        self,
        problem: Problem,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
        known: WorstCase | None = None,
    ) -> Answer:
        """Optimise, hold limits between the instants and in the worst case, find the error of the grid, report.

        `start`: decisions, None for their own initial values.
        """
        is_between = self.between != 1 and any(map(is_over_time, problem.constraints))
        prepare = functools.partial(prepare_check, check_factor(problem, self.between))
        transcribed = transcribe(problem, self.transcription, prepare)
        self.heed()
        begun = None if start is None else transcribed.point(start)
        meshed = self._meshed(transcribed, begun) if self.transcription.refines else _Meshed(transcribed, begun, None)
        transcribed, begun, _ = meshed
        factor = check_factor(transcribed.problem, self.between)
        starts_unknown = multipliers is None and not self.transcription.is_guessed
        is_judged = starts_unknown and factor > 1 and transcribed.problem.is_integrated
        first = transcribed.program.start if begun is None else begun
        transcribed, outcome, (between, check), worst_case = held_at_worst(
            transcribed,
            functools.partial(self._attempt, self.solver, meshed),
            functools.partial(self._attempt, self.solver.local, meshed),
            begun,
            multipliers,
            factor=factor if is_between else 1,
            known=known,
        )
        if outcome.status is Status.INTERRUPTED and outcome.searched is None:
            raise KeyboardInterrupt
        if outcome.failed_at is not None:
            outcome = replace(outcome, message=diagnose(transcribed, transcribed.decisions(outcome.failed_at)))
        error, misled = None, ""
        if check is not None and factor > 1:
            at_start = misled_at(transcribed, first, outcome.point, factor) if is_judged else ""
            error = replace(grid_error(transcribed, outcome.point, check, self.accuracy), at_start=at_start)
        if is_judged and outcome.status in UNSOLVED:
            misled = misled_at(transcribed, first, None, factor)
        if outcome.status is Status.INFEASIBLE and is_judged and not misled:
            least = begin_check(transcribed, outcome.point, factor)()
            misled = grid_error(transcribed, outcome.point, least, self.accuracy).unresolved
        found = solution_of(transcribed, outcome, between, error, worst_case, misled, check, self.compiled)
        return Answer(found, transcribed, outcome.point, check)

    def _meshed(self, transcribed: AbstractTranscribed, begun: np.ndarray | None) -> _Meshed:
        """The problem on a mesh that is fine enough, and its outcome; where one fails, it stays."""
        while True:
            self.heed()
            outcome = self._optimise(transcribed, self.solver, begun, None)
            if outcome.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            finer = transcribed.refined(outcome.point) if outcome.status is Status.SOLVED else None
            if finer is None:
                return _Meshed(transcribed, outcome.point if outcome.status is Status.SOLVED else begun, outcome)
            transcribed, begun = finer

    def _attempt(
        self,
        solver: AbstractSolver,
        meshed: _Meshed,
        transcribed: AbstractTranscribed,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
    ) -> tuple[Outcome, tuple[Between | None, Check | None]]:
        self.heed()
        known = meshed.outcome if transcribed is meshed.transcribed else None
        outcome = self._optimise(transcribed, solver, start, multipliers) if known is None else known
        if multipliers is None and outcome.status is not Status.INTERRUPTED:
            outcome = _looked_around(transcribed, solver.local, outcome, start)
        self.heed()
        outcome, between, check = held_between(transcribed, solver.local, outcome, self.between)
        return outcome, (between, check)

    def _optimise(
        self,
        transcribed: AbstractTranscribed,
        solver: AbstractSolver,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
    ) -> Outcome:
        rows = transcribed.program.constraint_lower.shape
        # Multipliers at the instants of another grid say nothing here.
        known = multipliers if multipliers is not None and multipliers.shape == rows else None
        executor = self.executor if isinstance(solver, AbstractSearch) else None
        program = valued_by(executor, transcribed.program, "solve")
        return solver.solve(program, start=start, multipliers=known)


def _looked_around(
    transcribed: AbstractTranscribed, solver: AbstractSolver, outcome: Outcome, start: np.ndarray | None
) -> Outcome:
    """The outcome of a start of which nothing is known, or a better one found by points elsewhere."""
    program, found = transcribed.program, outcome
    begun = program.start if start is None else start
    for _ in range(_MOST_RESTARTS):
        restart = restart_of(program, outcome, begun)
        outcome = replace(outcome, idle=restart.idle, blind=restart.blind)
        if restart.start is None:
            break
        further = solver.solve(restart.program, start=restart.start)
        if not restart.is_better(outcome, further):
            outcome = outcome.with_effort_of(further)
            break
        # Led away from a saddle, all of its variables may have ended on another one.
        outcome, begun = further.with_effort_of(outcome), further.point
    if outcome.searched is None:
        refuse_blind(outcome, transcribed)
        return outcome
    if outcome.status is Status.INTERRUPTED:
        return replace(found, status=Status.INTERRUPTED)
    # A search has compared values, so that it has chosen, though derivatives cannot confirm it.
    names = blind_decisions(outcome, transcribed)
    end = f"{outcome.searched.end}; its values alone chose {names}, by which its derivatives are zero"
    return replace(outcome, searched=replace(outcome.searched, end=end)) if names else outcome
