"""Numbers that stand in expressions, checked where they are given."""

from typing import Any

import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from aleator._core.arrays import Scalar
from aleator._core.border import is_masked, real_array
from aleator._core.errors import ProblemError


def number_given(value: Any, action: str) -> float:
    """A finite number as a float. Raises `ProblemError` for anything else: "Only numbers can" do `action`."""
    if is_masked(value):
        raise ProblemError(f"Only numbers can {action}; received {value}.")
    number = value
    if isinstance(value, np.generic | np.ndarray | Array) and not isinstance(value, Tracer) and value.ndim == 0:
        number = value.item()
    if not isinstance(number, int | float) or isinstance(number, bool):
        raise ProblemError(f"Only numbers can {action}; received {type(value).__name__} '{value}'.")
    if not np.isfinite(number):
        raise ProblemError(f"Only finite numbers can {action}; received {number}.")
    return float(number)


def smoothing_given(who: str, value: Any) -> float:
    """A smoothing as a float. Raises `ProblemError` if it is negative."""
    number = number_given(value, "smooth")
    if number < 0:
        raise ProblemError(f"{who}: expected a smoothing of at least 0; received {number:g}.")
    return number


def ordered(name: str, lower: Scalar, upper: Scalar) -> tuple[float, float]:
    """The bounds as floats. Raises `ProblemError` if they are in the wrong order or NaN."""
    lower, upper = (real_array(f"Constraint '{name}'", bound, "numbers as bounds") for bound in (lower, upper))
    if lower.ndim or upper.ndim:
        raise ProblemError(f"Constraint '{name}': expected one number as a bound; received {lower} and {upper}.")
    lower, upper = float(lower), float(upper)
    if np.isnan(lower) or np.isnan(upper):
        raise ProblemError(f"Constraint '{name}': expected numbers as bounds; received lower={lower}, upper={upper}.")
    if lower > upper:
        raise ProblemError(
            f"Constraint '{name}': expected lower <= upper; received lower={lower:g}, upper={upper:g}. Swap them."
        )
    return lower, upper
