"""Switching right-hand sides, smoothed over a stated width, which the certificate halves: friction, contact, stops.

All follow from `tanh`, so that a distance of ten widths from the switch leaves an error of 2e-9.
"""

from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import positive as positive_number
from aleator._core.border import refusal, traceable
from aleator._core.leaves import is_traced


@final
@dataclass
class Variation:
    """What differs in equations that are being traced from those that are declared.

    - `factor`: how many times as many steps simulations inside the model have, or as large widths are; `is_met`:
      whether there are any.
    """

    factor: float
    is_met: bool = False


WIDTHS: ContextVar[Variation | None] = ContextVar("widths", default=None)


def _over(width: Any) -> Any:
    """A width as it is taken now. Raises `ProblemError` unless it is positive."""
    if not is_traced(width):
        positive_number("smooth: width", width)
    widths = WIDTHS.get()
    if widths is None:
        return width
    widths.is_met = True
    return width if widths.factor == 1 else widths.factor * width


def sign(x: Any, *, width: Any) -> Float[Array, "*shape"]:
    """The sign of a number, between -1 and 1 within some widths of zero.

    Coulomb friction is `-mu * N * sign(v, width=...)`: under a `force`, a body that would stick creeps at about
    `force / (mu * N)` widths. `width` is in the unit of the number.
    """
    return jnp.tanh(traceable("smooth: x", x) / _over(width))


def sign_residual(s: Any, x: Any, *, width: Any) -> Float[Array, "*shape"]:
    """What is zero where `s = sign(x, width=...)`: the `residual` of an algebraic variable, for small widths.

    It is the complementarity of friction and velocity, relaxed by the width (Chen and Mangasarian, 1996, A class of
    smoothing functions for nonlinear and mixed complementarity problems). Its derivatives stay as large as one and `x`
    for any width, so that `al.Simultaneous()`, where `s` is a variable too, follows widths down to nearly zero.
    """
    s, x = traceable("smooth: s", s), traceable("smooth: x", x)
    return jnp.hypot(x, _over(width)) * (s - sign(x, width=width))


def step(x: Any, *, width: Any) -> Float[Array, "*shape"]:
    """1 where `x` is positive, else 0."""
    return (1 + sign(x, width=width)) / 2


def positive(x: Any, *, width: Any) -> Float[Array, "*shape"]:
    """A number where it is positive, else 0; 0.35 widths at zero.

    A contact that only pushes is `stiffness * positive(depth, width=...)`.
    """
    half = _over(width) / 2
    return half * jnp.logaddexp(traceable("smooth: x", x) / half, 0.0)


def saturated(x: Any, lower: Any, upper: Any, *, width: Any) -> Float[Array, "*shape"]:
    """`x` between two limits, `lower` or `upper` beyond them: an actuator that gives no more.

    Raises `ProblemError` for known limits in the wrong order.
    """
    _refuse_crossed("smooth: saturated", "lower <= upper", lower, upper, (lower, upper))
    x, lower, upper = (
        traceable(f"smooth: {name}", one) for name, one in (("x", x), ("lower", lower), ("upper", upper))
    )
    return lower + positive(x - lower, width=width) - positive(x - upper, width=width)


def dead_zone(x: Any, half_gap: Any, *, width: Any) -> Float[Array, "*shape"]:
    """How far `x` is beyond a gap on either side of zero: the twist that a shaft with backlash passes on.

    Raises `ProblemError` for a known gap below zero.
    """
    _refuse_crossed("smooth: dead_zone", "half_gap >= 0", 0.0, half_gap, half_gap)
    x, half_gap = traceable("smooth: x", x), traceable("smooth: half_gap", half_gap)
    return positive(x - half_gap, width=width) - positive(-x - half_gap, width=width)


def _refuse_crossed(what: str, expected: str, lower: Any, upper: Any, received: Any) -> None:
    """Raise `ProblemError` for plain numbers in the wrong order: what is computed is traced where equations are."""
    plain = int | float | np.ndarray | np.generic
    if isinstance(lower, plain) and isinstance(upper, plain) and np.any(np.asarray(lower) > np.asarray(upper)):
        raise refusal(what, expected, received)
