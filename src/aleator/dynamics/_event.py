"""`Event`: when something happens to a system, and what it does to the states; what counts as a crossing of zero."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from aleator._core.border import refusal

CLOSE = 1e-9
"""A correction that is a smaller part of a step, or of the time, is rounding. Sides of zero look ahead by as much."""


@final
@dataclass(frozen=True)
class Event:
    """What happens when a function of a system crosses zero: in each realisation at a time of its own.

    Functions take the system, as its methods do, and the inputs that they name; both stand in the `events` of a
    `System`, by the name of the event: `events = {"floor": al.Event(lambda self, t, z: z.y, direction=-1)}`.

    - `function(self, t, z, ...)`: one number, whose rate is not zero where it crosses zero;
    - `direction`: 1 where it rises through zero, -1 where it falls, 0 for both;
    - `jump(self, t, z, ...)`: what some states are set to when it happens, by name, such as `{"v": -self.e * z.v}`; all
      others go on. None: nothing changes.

    A step ends at each event that has a jump or is asked for (`al.at`), whatever the integrator, so that what follows
    has exact derivatives: in forward mode, `jax.jacfwd`. A function that crosses zero and back within one step is not
    seen, nor is one that a jump takes to the other side.

    Raises `ProblemError` for anything but functions, and for another direction.
    """

    function: Callable[..., Any]
    direction: int = 0
    jump: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise refusal("Event: function", "a function such as lambda self, t, z: z.y", self.function)
        if isinstance(self.direction, bool) or self.direction not in (-1, 0, 1):
            raise refusal("Event: direction", "1 (rising), -1 (falling) or 0 (both)", self.direction)
        if not (self.jump is None or callable(self.jump)):
            raise refusal("Event: jump", "a function such as lambda self, t, z: {'v': -self.e * z.v}", self.jump)


def crosses_zero(level: Array, rate: Array, level_at: Array, rate_at: Array, directions: Any) -> Bool[Array, " n"]:
    """Whether levels end on the other side of zero, in a direction that counts.

    - `rate`: in a step. The side is that of a moment later: so a start on the ground is no landing.
    """
    is_above, ends_above = level + CLOSE * rate >= 0, level_at + CLOSE * rate_at >= 0
    counts = ends_above & np.asarray(directions >= 0) | is_above & np.asarray(directions <= 0)
    return (is_above != ends_above) & counts & jnp.isfinite(level_at)


def is_near(level: Array, rate: Array) -> Array:
    """Whether levels are zero up to rounding."""
    return jnp.abs(level) <= CLOSE * jnp.abs(rate)
