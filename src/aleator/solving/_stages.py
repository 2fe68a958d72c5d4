"""The stages of one solution: transcribe, search and hold limits, judge the grid, say."""

import functools
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
    lost_derivatives,
    misled_at,
    moved_correlations,
    prepare_check,
    second_opinion,
    solution_of,
    untrusted,
)
from aleator.design import Problem
from aleator.nlp import Status
from aleator.solution import Solution, WorstCase
from aleator.solving._rounds import Rounds
from aleator.transcription import AbstractTranscribed, AbstractTranscription, transcribe

UNSOLVED = (Status.INFEASIBLE, Status.FAILED, Status.ITERATION_LIMIT)
"""Ends of a search that a grid which is far off may have led astray."""


class Answer(NamedTuple):
    """A solution, the program that it was found by, the point of that program that it stands for, and its check."""

    solution: Solution
    transcribed: AbstractTranscribed
    point: np.ndarray
    check: Check | None

    def with_opinion(self) -> Solution:
        """The solution with what fresh systems say of its expansions, unless its grid is no good already."""
        solution, problem, transcribed = self.solution, self.solution.problem, self.transcribed
        if not solution.ok:
            return solution
        certificate = replace(
            solution.certificate,
            opinion=None if self.check is None else second_opinion(transcribed, self.point, self.check),
            # A search has compared values.
            lost="" if solution.effort.searched else lost_derivatives(transcribed, self.point, solution.multipliers),
            untrusted=untrusted(problem, solution.certificate.expansion),
            correlations=moved_correlations(problem, solution.vector),
        )
        return replace(solution, certificate=certificate)


class Stages(NamedTuple):
    """The stages of one solution, the same on each grid."""

    transcription: AbstractTranscription
    rounds: Rounds
    accuracy: float
    compiled_before: float

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
        prepare = functools.partial(prepare_check, check_factor(problem, self.rounds.between))
        transcribed = transcribe(problem, self.transcription, prepare)
        begun = None if start is None else transcribed.point(start)
        held = self.rounds.held(transcribed, begun, multipliers, known, refines=self.transcription.refines)
        transcribed, outcome, check = held.transcribed, held.outcome, held.check
        if outcome.status is Status.INTERRUPTED and outcome.searched is None:
            raise KeyboardInterrupt
        if outcome.failed_at is not None:
            outcome = replace(outcome, message=diagnose(transcribed, transcribed.decisions(outcome.failed_at)))
        factor = check_factor(transcribed.problem, self.rounds.between)
        starts_unknown = multipliers is None and not self.transcription.is_guessed
        is_judged = starts_unknown and factor > 1 and transcribed.problem.is_integrated
        error, misled = None, ""
        if check is not None and factor > 1:
            at_start = misled_at(transcribed, held.first, held.begun, outcome.point, factor) if is_judged else ""
            error = replace(grid_error(transcribed, outcome.point, check, self.accuracy), at_start=at_start)
        if is_judged and outcome.status in UNSOLVED:
            misled = misled_at(transcribed, held.first, held.begun, None, factor)
        if outcome.status is Status.INFEASIBLE and is_judged and not misled:
            least = begin_check(transcribed, outcome.point, factor)()
            misled = grid_error(transcribed, outcome.point, least, self.accuracy).unresolved
        solution = solution_of(transcribed, outcome, held.between, error, held.worst_case, misled, check, self.compiled)
        return Answer(solution, transcribed, outcome.point, check)
