"""Levels and thresholds of statistics as given by a user, checked unless they are traced."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError


def is_traced(value: Any) -> bool:
    """Whether a number is being traced, so that its value is unknown."""
    return isinstance(value, Tracer)


def level_given(kind: str, level: Any) -> Scalar:
    """A probability level, strictly between 0 and 1. Raises `ProblemError` for any other value."""
    number = number_given(kind, "level", level)
    if not is_traced(number) and not 0 < float(number) < 1:
        raise ProblemError(
            f"{kind}: expected a level between 0 and 1, such as 0.99; received {level!r}. The ends of the distribution "
            "are Supremum and Infimum."
        )
    return number


def number_given(kind: str, name: str, value: Any) -> Scalar:
    """A finite number; an array of JAX, traced or not, stays one. Raises `ProblemError` for anything else."""
    if isinstance(value, jax.Array) and value.ndim == 0:
        if is_traced(value) or np.isfinite(value):
            return value
    elif isinstance(value, int | float | np.number) and not isinstance(value, bool) and np.isfinite(value):
        return float(value)
    raise ProblemError(f"{kind}: {name} is one finite number; received {value!r}.")
