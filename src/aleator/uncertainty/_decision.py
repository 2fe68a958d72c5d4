"""`Decision`: a number of a model that the optimiser chooses."""

import abc
from typing import Any, final

import equinox as eqx
import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import a_name, real_array, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, highest, lowest

# Relative amount by which a start may lie outside its bounds: a computed one may do so by rounding.
_ROUNDING = 1e-9


class AbstractDecision(AbstractLeaf):
    """A number of a model, or an array of numbers, that the optimiser chooses between a lower and an upper bound."""

    initial: eqx.AbstractVar[Any]
    lower: eqx.AbstractVar[Any]
    upper: eqx.AbstractVar[Any]

    @property
    def values(self) -> Float[np.ndarray, " rows"] | None:
        """The values that it may have; None for all between its bounds."""
        return None

    @property
    def is_designed(self) -> bool:
        """Whether the optimiser chooses it, rather than an opponent."""
        return True

    @abc.abstractmethod
    def domain(self) -> str:
        """What it may be, in words."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the numbers that are chosen."""
        return np.shape(self.initial)

    def lowest(self) -> float | None:
        """The smallest number that may be chosen."""
        return lowest(self.lower)

    def highest(self) -> float | None:
        """The largest number that may be chosen."""
        return highest(self.upper)


@final
class Decision(AbstractDecision):
    """A number (or an array of numbers) that the optimiser chooses, placed anywhere in a model.

    `Decision(30e3, lower=23_339, upper=300e3)` starts at 30 000. An array as `initial` makes one decision of each
    entry, with a common bound or one each. Two placements are two decisions, even of the same object, unless both were
    made with `shared("name")`: then they are one.

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
        self.shared_name = None if shared_name is None else a_name("Decision: shared_name", shared_name)

    def shared(self, name: str) -> "Decision":
        """A copy whose placements are all one decision, together with any others shared under this name."""
        return Decision(self.initial, self.lower, self.upper, shared_name=a_name("shared", name))

    @override
    def domain(self) -> str:
        return f"[{ends(self.lower)}, {ends(self.upper)}]"


def ends(values: Any) -> str:
    """The smallest and the largest of some numbers, as text."""
    low, high = float(np.min(np.asarray(values))), float(np.max(np.asarray(values)))
    return f"{low:g}" if low == high else f"{low:g}…{high:g}"


def _real(value: Any) -> np.ndarray:
    return real_array("A Decision", value, "numbers or arrays of numbers")


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


def start_given(name: str, value: Any, decision: AbstractDecision) -> Float[np.ndarray, "..."]:
    """Another start of a decision, clipped to its bounds, which it may exceed only by rounding."""
    expected = f"finite numbers of shape {decision.shape}"
    numbers = real_array(f"start: '{name}'", value, expected)
    if numbers.shape != decision.shape or not np.isfinite(numbers).all():
        raise refusal(f"start: '{name}'", expected, value)
    inside = np.clip(numbers, np.asarray(decision.lower), np.asarray(decision.upper))
    beyond = np.abs(inside - numbers) > _ROUNDING * np.maximum(np.abs(numbers), np.abs(inside))
    if beyond.any():
        first = np.flatnonzero(beyond)[0]
        lower, upper, start = (
            np.broadcast_to(value, numbers.shape).flat[first] for value in (decision.lower, decision.upper, numbers)
        )
        raise ProblemError(f"start: expected '{name}' between its bounds {lower:g} and {upper:g}; received {start:g}.")
    return inside
