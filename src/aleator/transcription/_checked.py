"""Refuse an inconsistent transcription before it is used."""

from typing import Any

import numpy as np

from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator._core.identity import is_library
from aleator.design import Problem
from aleator.nlp import Evaluation, NonlinearProgram
from aleator.transcription._abstract import AbstractTranscribed, AbstractTranscription, Meaning

# Largest relative difference, due to rounding, between the program at a point and the point's meaning.
_ROUNDING = 1e-9


def checked(found: Any, transcription: AbstractTranscription, problem: Problem) -> AbstractTranscribed:
    """Return the result of a transcription. Raises `ProblemError` if a user's own does not fit its problem.

    At the initial decisions, the numbers of the program and of the point's meaning are compared.
    """
    who = f"{type(transcription).__name__}.transcribed"
    if not isinstance(found, AbstractTranscribed):
        raise refusal(who, "an AbstractTranscribed", found)
    if is_library(type(found).__module__):
        return found
    program = found.program
    if not isinstance(program, NonlinearProgram):
        raise refusal(f"{who}: program", "a NonlinearProgram", program)
    size, initial = program.start.size, problem.placements.vector("initial")
    decided = np.asarray(found.decided)
    if decided.dtype.kind not in "iu" or decided.shape != initial.shape or len(set(decided.tolist())) != len(initial):
        raise refusal(f"{who}: decided", f"which {len(initial)} of the program's variables are decisions", decided)
    if len(initial) and not (decided.min() >= 0 and decided.max() < size):
        raise refusal(f"{who}: decided", f"indices below {size}, the program's variables", decided)
    if len(found.rows) != len(problem.constraints):
        raise refusal(f"{who}: rows", f"those of {len(problem.constraints)} constraints", found.rows)
    point = np.asarray(found.point(initial))
    if point.shape != (size,) or not np.array_equal(point[decided], initial):
        raise refusal(f"{who}: point", f"{size} numbers, the given decisions among them", point)
    evaluation, meaning = program.evaluate(point), found.at(point)
    if not isinstance(evaluation, Evaluation):
        raise refusal(f"{who}: program.evaluate", "an Evaluation", evaluation)
    if not isinstance(meaning, Meaning):
        raise refusal(f"{who}: at", "a Meaning", meaning)
    if len(meaning.constraints) != len(found.rows):
        raise refusal(f"{who}: at", f"the rows of {len(found.rows)} constraints", meaning.constraints)
    _compare(f"{who}: the objective", evaluation.objective, meaning.objective)
    for one, rows, own in zip(problem.constraints, found.rows, meaning.constraints, strict=True):
        _compare(f"{who}: constraint '{one.name}'", evaluation.constraints[rows], own)
    return found


def _compare(what: str, program: Any, meaning: Any) -> None:
    ours, theirs = np.ravel(program), np.ravel(meaning)
    if ours.shape == theirs.shape and np.allclose(ours, theirs, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True):
        return
    raise ProblemError(
        f"{what}: expected equal numbers in the program and in the meaning of its point, at the start; received "
        f"{_first(ours)} and {_first(theirs)}."
    )


def _first(numbers: np.ndarray) -> str:
    shown = np.array2string(numbers[:3], precision=6)
    return shown if len(numbers) <= 3 else f"{shown} and {len(numbers) - 3} more"
