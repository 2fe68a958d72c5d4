"""`Event`: when something happens to a system, and what it does to the states; what counts as a crossing of zero."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

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


class Fault(NamedTuple):
    """What goes wrong in each step: what (0: nothing), with which event, about when, s, and after how many; the first
    number of the vector that is not finite then.
    """

    kind: Int[Array, " steps"]
    event: Int[Array, " steps"]
    t: Float[Array, " steps"]
    met: Int[Array, " steps"]
    number: Int[Array, " steps"]


def level_and_rate(
    function: Callable[..., Array], place: tuple[Any, ...], slopes: tuple[Any, ...]
) -> tuple[Array, Array]:
    """The functions of events at a place, and their rates along slopes there; zero where these are not finite, as that
    of a root of nothing, so that levels alone tell a side.
    """
    level, rate = jax.jvp(function, place, slopes)
    return level, jax.lax.select(jnp.isfinite(rate), rate, jnp.zeros_like(rate))


def crosses_zero(level: Array, rate: Array, level_at: Array, rate_at: Array, directions: Any) -> Bool[Array, " n"]:
    """Whether levels leave their side of zero, in a direction that counts; those at rest on zero have none to leave.

    - `rate`: in a step. The side is that of a moment later: so a start on the ground is no landing.
    """
    side, later = jnp.sign(level + CLOSE * rate), level_at + CLOSE * rate_at
    return (side != 0) & (side * later <= 0) & (side * directions <= 0) & jnp.isfinite(level_at)


def leads_across(level: Array, rate: Array, directions: Any) -> Bool[Array, " n"]:
    """Whether levels are zero up to rounding, and move on in a direction that counts."""
    return (jnp.abs(level) <= CLOSE * jnp.abs(rate)) & (rate != 0) & (rate * directions >= 0)
