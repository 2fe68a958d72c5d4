"""Checks of the arguments of signals, made before anything is computed."""

from typing import Any

import jax
import numpy as np

from aleator._core.errors import ProblemError
from aleator.uncertainty import AbstractDistribution, Decision


def plain_number(owner: str, name: str, value: Any) -> float:
    """A finite plain number. Raises `ProblemError` for anything else, such as a decision."""
    if isinstance(value, AbstractDistribution | Decision):
        raise ProblemError(
            f"{owner}: '{name}' sets the covariance's eigenfunctions, which are computed once; expected a plain "
            f"number; received {value}. Make `std` or `mean` uncertain or decided instead."
        )
    number = _finite(value)
    if number is None:
        raise ProblemError(f"{owner}: '{name}' is a finite number; received {value!r}.")
    return number


def positive_number(owner: str, name: str, value: Any) -> float:
    """A positive finite plain number. Raises `ProblemError` for anything else."""
    number = plain_number(owner, name, value)
    if not number > 0:
        raise ProblemError(f"{owner}: '{name}' must be positive; received {number:g}.")
    return number


def number_or_distribution(owner: str, name: str, value: Any) -> Any:
    """One number of a model: plain, uncertain, decided or traced by JAX. Raises `ProblemError` for anything else."""
    if isinstance(value, AbstractDistribution) or (isinstance(value, jax.Array) and value.ndim == 0):
        return value
    if isinstance(value, Decision) and np.ndim(value.initial) == 0:
        return value
    number = _finite(value)
    if number is None:
        raise ProblemError(f"{owner}: '{name}' takes one number, one distribution or one Decision; received {value!r}.")
    return number


def _finite(value: Any) -> float | None:
    """A finite plain number as a float; `None` for anything else."""
    is_real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return float(value) if is_real and np.isfinite(value) else None
