"""`transcribe`: from a declared problem to its nonlinear program, which is kept for a while."""

import threading
from collections import deque
from typing import Any

import jax
import numpy as np

from aleator._core.errors import ProblemError
from aleator.design import Problem, current
from aleator.transcription._abstract import AbstractTranscribed, AbstractTranscription, Meanwhile
from aleator.transcription._checked import checked
from aleator.transcription.sequential import Sequential

DEFAULT = Sequential()
"""How problems are transcribed unless it is said."""

# Enough for a problem and its deterministic twin, each solved from many starts.
_KEPT = 4

_RECENT: deque[tuple[AbstractTranscription, list[Any], AbstractTranscribed]] = deque(maxlen=_KEPT)
_LOCK = threading.Lock()


def transcribe(
    problem: Problem, transcription: AbstractTranscription = DEFAULT, meanwhile: Meanwhile = lambda *_: None
) -> AbstractTranscribed:
    """Turn a declared problem into a nonlinear program, compiling it if no problem of its structure has been before.

    `meanwhile` is called just before it is compiled, to begin what can be done beside that.

    A problem that was transcribed a short while ago, such as by a solution from another start, is not again. One whose
    code has changed since it was declared is transcribed as it is now. Raises `ProblemError` if the problem has no
    decisions.
    """
    problem = current(problem)
    numbers = jax.tree.leaves(problem)
    with _LOCK:
        recent = list(_RECENT)
    for how, known, found in recent:
        if found.problem is problem and how == transcription and _same(known, numbers):
            return found
    if problem.placements.size == 0:
        raise ProblemError(
            "The problem has no decisions: put al.Decision(initial, lower, upper) in the place of a number of it."
        )
    found = checked(transcription.transcribed(problem, meanwhile), transcription, problem)
    kept = [leaf.copy() if isinstance(leaf, np.ndarray) else leaf for leaf in numbers]
    with _LOCK:
        _RECENT.append((transcription, kept, found))
    return found


def _same(first: list[Any], second: list[Any]) -> bool:
    """Whether the numbers of a problem are still what they were: arrays can be changed in place."""
    return len(first) == len(second) and all(
        np.array_equal(one, other) if isinstance(one, np.ndarray) else one is other
        for one, other in zip(first, second, strict=True)
    )
