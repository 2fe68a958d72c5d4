"""`transcribe`: from a declared problem to its nonlinear program, with a cache."""

import threading
from collections import deque
from typing import Any

import jax
import numpy as np

from aleator._core.errors import ProblemError
from aleator.design import Problem
from aleator.transcription._abstract import AbstractTranscribed, AbstractTranscription, Meanwhile
from aleator.transcription._checked import checked
from aleator.transcription.sequential import Sequential

DEFAULT = Sequential()
"""The default transcription."""

# Size of the cache: enough for a problem and its deterministic twin, each solved from many starts.
_KEPT = 4

_RECENT: deque[tuple[AbstractTranscription, list[Any], AbstractTranscribed]] = deque(maxlen=_KEPT)
_LOCK = threading.Lock()


def transcribe(
    problem: Problem, transcription: AbstractTranscription = DEFAULT, meanwhile: Meanwhile = lambda *_: None
) -> AbstractTranscribed:
    """Turn a declared problem into a nonlinear program, compiled unless one of the same structure was before.

    `meanwhile` is called just before compilation, to begin work in parallel.

    A problem that was transcribed recently, such as for a solve from another start, is reused. If the problem's code
    has changed since its declaration, the present code is transcribed. Raises `ProblemError` if the problem has no
    decisions.
    """
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
    """Whether the numbers of a problem are unchanged: arrays can be modified in place."""
    return len(first) == len(second) and all(
        np.array_equal(one, other) if isinstance(one, np.ndarray) else one is other
        for one, other in zip(first, second, strict=True)
    )
