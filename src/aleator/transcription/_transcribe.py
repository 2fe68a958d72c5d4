"""`transcribe`: from a declared problem to its nonlinear program, with a cache."""

import threading
from collections import deque
from typing import Any

import jax
import numpy as np

from aleator._core.border import one_of, refusal, shown
from aleator._core.errors import ProblemError
from aleator._core.identity import is_library
from aleator.design import Problem
from aleator.nlp import Evaluation, NonlinearProgram
from aleator.transcription._abstract import AbstractTranscribed, AbstractTranscription, Meaning, Meanwhile
from aleator.transcription.sequential import Sequential
from aleator.uncertainty import refuse_intervals

DEFAULT = Sequential()
"""The default transcription."""

# Size of the cache: enough for a problem and its deterministic twin, each solved from many starts.
_KEPT = 4

_RECENT: deque[tuple[AbstractTranscription, list[Any], AbstractTranscribed]] = deque(maxlen=_KEPT)
_LOCK = threading.Lock()

# Largest relative difference, due to rounding, between the program at a point and the point's meaning.
_ROUNDING = 1e-9


def transcribe(
    problem: Problem, transcription: AbstractTranscription = DEFAULT, meanwhile: Meanwhile = lambda *_: lambda: None
) -> AbstractTranscribed:
    """Turn a declared problem into a nonlinear program, compiled unless one of the same structure was before.

    `meanwhile` is called just before compilation, to begin work in parallel; what it returns completes this.

    A problem that was transcribed recently, such as for a solve from another start, is reused. Raises `ProblemError`
    if the problem has no decisions.
    """
    instead = "Limits are held for all of its values by al.solve, and by what makes each of its steps such a solve."
    refuse_intervals(type(problem).__name__, problem.placements, instead)
    numbers = jax.tree.leaves(problem)
    with _LOCK:
        recent = list(_RECENT)
    for how, known, transcribed in recent:
        if transcribed.problem is problem and how == transcription and _same(known, numbers):
            return transcribed
    if problem.placements.size == 0:
        raise ProblemError(
            "The problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number of it."
        )
    transcribed = _checked(transcription.transcribed(problem, meanwhile), transcription, problem)
    copied = [leaf.copy() if isinstance(leaf, np.ndarray) else leaf for leaf in numbers]
    with _LOCK:
        _RECENT.append((transcription, copied, transcribed))
    return transcribed


def _same(first: list[Any], second: list[Any]) -> bool:
    """Whether the numbers of a problem are unchanged: arrays can be modified in place."""
    return len(first) == len(second) and all(
        np.array_equal(one, other) if isinstance(one, np.ndarray) else one is other
        for one, other in zip(first, second, strict=True)
    )


def _checked(transcribed: Any, transcription: AbstractTranscription, problem: Problem) -> AbstractTranscribed:
    """Return the result of a transcription. Raises `ProblemError` if a user's own does not fit its problem.

    At the initial decisions, the numbers of the program and of the point's meaning are compared.
    """
    who = f"{type(transcription).__name__}.transcribed"
    one_of(who, transcribed, AbstractTranscribed)
    if is_library(type(transcribed).__module__):
        return transcribed
    program = one_of(f"{who}: program", transcribed.program, NonlinearProgram)
    size, initial = program.start.size, problem.placements.vector("initial")
    decided, count = np.asarray(transcribed.decided), len(problem.constraints)
    if decided.shape != initial.shape or not set(decided.tolist()) <= set(range(size)):
        raise refusal(f"{who}: decided", f"which {len(initial)} of its {size} variables are decisions", decided)
    point = np.asarray(transcribed.point(initial))
    if point.shape != (size,) or not np.array_equal(point[decided], initial):
        raise refusal(f"{who}: point", f"{size} numbers, the given decisions among them", point)
    evaluation = one_of(f"{who}: program.evaluate", program.evaluate(point), Evaluation)
    meaning = one_of(f"{who}: at", transcribed.at(point), Meaning)
    for name, rows in (("rows", transcribed.rows), ("at", meaning.constraints)):
        if len(rows) != count:
            raise refusal(f"{who}: {name}", f"those of {count} constraints", rows)
    pairs: list[tuple[str, Any, Any]] = [("the objective", evaluation.objective, meaning.objective)]
    for one, rows, own in zip(problem.constraints, transcribed.rows, meaning.constraints, strict=True):
        pairs.append((f"constraint '{one.name}'", evaluation.constraints[rows], own))
    for what, *both in pairs:
        ours, theirs = map(np.ravel, both)
        same = ours.shape == theirs.shape
        if not (same and np.allclose(ours, theirs, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True)):
            raise ProblemError(
                f"{who}: {what}: expected equal numbers in the program and in the meaning of its point, at the start; "
                f"received {shown(ours)} and {shown(theirs)}."
            )
    return transcribed
