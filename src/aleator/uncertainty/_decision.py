"""`Decision`: a number of a model that the optimiser chooses."""

from typing import Any, final

import equinox as eqx
import numpy as np

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError


@final
class Decision(eqx.Module):
    """A number (or an array of numbers) that the optimiser chooses, placed anywhere in a model.

    `Decision(30e3, lower=23_339, upper=300e3)` starts at 30 000. An array as `initial` makes as many decisions, with
    one bound for all or one each. Two placements are two decisions, even of the same object, unless both were made with
    `shared("name")`: then they are one.

    Raises `ProblemError` if a number is not finite (bounds may be infinite), if the bounds are in the wrong order, or
    if the start lies outside them.
    """

    initial: Scalar | np.ndarray
    lower: Scalar | np.ndarray
    upper: Scalar | np.ndarray
    shared_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        initial: Any,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        *,
        shared_name: str | None = None,
    ):
        start, *bounds = (_real(value) for value in (initial, lower, upper))
        _check(start, *bounds)
        self.initial, self.lower, self.upper = (
            float(value) if start.ndim == 0 else np.broadcast_to(value, start.shape).copy()
            for value in (start, *bounds)
        )
        self.shared_name = shared_name

    def shared(self, name: str) -> "Decision":
        """The same decision wherever it is placed: all placements shared under one name are one decision."""
        return Decision(self.initial, self.lower, self.upper, shared_name=name)


def _real(value: Any) -> np.ndarray:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"A Decision takes numbers or arrays of numbers; received {value!r}.") from error


def _check(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    if not np.all(np.isfinite(start)):
        raise ProblemError(f"A Decision starts at a finite value; received {start}.")
    for bound in (lower, upper):
        if bound.shape not in ((), start.shape):
            raise ProblemError(
                f"A Decision's bounds are one number or have shape {start.shape}; received {bound.shape}."
            )
    if np.any(np.isnan(lower) | np.isnan(upper)) or np.any(lower > upper):
        raise ProblemError(
            f"A Decision's lower bound must not exceed its upper bound; received lower={lower}, upper={upper}. "
            "Swap them."
        )
    if np.any(start < lower) or np.any(start > upper):
        raise ProblemError(f"A Decision starts between its bounds [{lower}, {upper}]; received {start}.")
