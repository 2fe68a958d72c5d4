"""Trajectories: signals over a duration that is set elsewhere, with their derivatives."""

import abc
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import realised_shape, stored_numbers
from aleator.trajectories._signals import AbstractSignal, Fractions


class AbstractTrajectory(AbstractSignal):
    """A signal that spans the time grid of its problem: a free final time only scales it.

    It is a function of the fraction of the duration, from 0 at the start to 1 at the end; its derivatives are with
    respect to time, in seconds. When called by itself it lasts one second. `curve_fields` names the fields in which the
    curve is affine, to which a solution of a coarser problem can be refitted.
    """

    declares_jumps: ClassVar[bool] = True
    curve_fields: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        """The time derivative of order `order` (0: the value) at fractions of the duration (s): shape (n, ...)."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """The shape of one value: `()` for a number, `(n,)` for n joints."""

    @property
    def derivatives(self) -> float:
        """How many time derivatives it has whatever its numbers are; any number by default."""
        return np.inf

    def breaks(self) -> Float[np.ndarray, " ends"]:
        """The fractions at which the smooth pieces of a realised trajectory begin and end; one piece by default."""
        return np.array([0.0, 1.0])

    def derivative(self, order: int = 1) -> "Derivative":
        """The time derivative as a trajectory of its own. Raises `ProblemError` for a negative order."""
        if isinstance(order, bool) or not isinstance(order, int) or order < 0:
            raise ProblemError(f"derivative: expected an order of 0, 1, 2, ...; received {order!r}.")
        return Derivative(self, order)

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return self.values(jnp.asarray(t)[None])[0]

    @override
    def over(self, t_start: Any, t_final: Any) -> AbstractSignal:
        return _Stretched(self, t_start, t_final)

    @override
    def sampled(self, fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        """As for any signal; at fixed fractions, whatever depends on these alone is computed once."""
        return self.values(fractions, t_final - t_start)


@final
class Derivative(AbstractTrajectory):
    """A time derivative of a trajectory; see `AbstractTrajectory.derivative`."""

    trajectory: AbstractTrajectory
    order: int = eqx.field(static=True)

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        return self.trajectory.values(fractions, duration, self.order + order)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return self.trajectory.shape


@final
class Stack(AbstractTrajectory):
    """Scalar trajectories side by side: one trajectory of several joints."""

    parts: tuple[AbstractTrajectory, ...]

    @property
    @override
    def derivatives(self) -> float:
        return min(part.derivatives for part in self.parts)

    @override
    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n parts"]:
        xp, parts = in_library([part.values(fractions, duration, order) for part in self.parts])
        return jax_array(xp.stack(parts, axis=-1))

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return (len(self.parts),)


@final
class _Stretched(AbstractSignal):
    """A trajectory stretched between two times."""

    trajectory: AbstractTrajectory
    t_start: Any
    t_final: Any

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        duration = self.t_final - self.t_start
        return self.trajectory.values(((t - self.t_start) / duration)[None], duration)[0]


def as_array(number: Any) -> Float[Array, "..."]:
    """A realised number, or a sequence of them, as an array."""
    if isinstance(number, list | tuple):
        xp, *entries = in_library(*(as_array(one) for one in number))
        return jax_array(xp.stack(entries))
    return jax_array(number, float)


def conditions(kind: str, where: str, values: Any, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Conditions at one end, `(value, velocity, acceleration)` or the first of them, each of the trajectory's shape.

    Zero stands for zeros of any shape. Raises `ProblemError` for more than three or for other shapes.
    """
    values = tuple(values) if isinstance(values, list | tuple) else (values,)
    if len(values) > 3:
        raise ProblemError(
            f"{kind}: expected at the {where} a value, a velocity and an acceleration, or the first one or two of "
            f"them; received {len(values)} conditions."
        )
    stored = []
    for number, name in zip(values, ("value", "velocity", "acceleration"), strict=False):
        is_zero = isinstance(number, int | float) and number == 0
        if realised_shape(number) != shape and not is_zero:
            raise ProblemError(
                f"{kind}: expected a {name} of shape {shape} at the {where}, that of its control points; "
                f"received shape {realised_shape(number)}."
            )
        stored.append(np.zeros(shape) if is_zero else stored_numbers(f"{kind}: {name} at the {where}", number))
    return tuple(stored)
