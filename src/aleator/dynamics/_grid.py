"""The instants at which a simulation is recorded: a `Grid` of them or, without time, one `Instant`."""

import abc
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError


class AbstractGrid(eqx.Module):
    """The instants at which outputs are known: the leading axis of every history."""

    @property
    @abc.abstractmethod
    def times(self) -> Float[Array, " instants"]:
        """All instants, in seconds."""

    @property
    @abc.abstractmethod
    def weights(self) -> Float[Array, " instants"]:
        """Weights of the quadrature rule on the instants."""


@final
class Grid(AbstractGrid):
    """Uniform instants from `t_start` to `t_final`, `steps` steps apart: `steps + 1` instants, in seconds."""

    t_final: Scalar
    steps: int = eqx.field(static=True)
    t_start: Scalar

    def __init__(self, t_final: float, steps: int, t_start: float = 0.0):
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
            raise ProblemError(f"Grid: steps is a whole number of at least 1; received {steps!r}.")
        if not (_is_finite(t_start) and _is_finite(t_final) and t_final > t_start):
            raise ProblemError(
                f"Grid: t_final must be a finite number after t_start={t_start!r}; received t_final={t_final!r}."
            )
        self.t_final = float(t_final)
        self.steps = int(steps)
        self.t_start = float(t_start)

    @property
    def step(self) -> Scalar:
        """Length of one step."""
        return (self.t_final - self.t_start) / self.steps

    @property
    def times(self) -> Float[Array, " instants"]:
        """All instants."""
        # linspace ends at t_final to the last bit; beyond it a signal or an adaptive integrator knows nothing.
        return jnp.linspace(self.t_start, self.t_final, self.steps + 1)

    @property
    def weights(self) -> Float[Array, " instants"]:
        """Weights of the trapezoidal rule on the instants."""
        ends = jnp.ones(self.steps + 1).at[jnp.array([0, -1])].set(0.5)
        return jnp.asarray(self.step * ends)


@final
class Instant(AbstractGrid):
    """No time: the one instant, `t = 0`, of a system of algebraic equations. A sum over it is the value itself."""

    @property
    def times(self) -> Float[Array, " instants"]:
        """The one instant."""
        return jnp.zeros(1)

    @property
    def weights(self) -> Float[Array, " instants"]:
        """The weight of the one instant."""
        return jnp.ones(1)


def _is_finite(number: object) -> bool:
    return isinstance(number, int | float | np.number) and bool(np.isfinite(number))
