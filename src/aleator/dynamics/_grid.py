"""The instants at which a simulation is recorded: a `Grid` of them or, without time, one `Instant`."""

import abc
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar, decided_bounds
from aleator._core.errors import ProblemError
from aleator.trajectories import instants


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
    """Uniform instants from `t_start` to `t_final`, `steps` steps apart: `steps + 1` instants, in seconds.

    `t_final` may be a `Decision`: a free final time. Trajectories among the inputs fill the grid, however long it is.
    """

    t_final: Any
    steps: int = eqx.field(static=True)
    t_start: Scalar

    def __init__(self, t_final: Any, steps: int, t_start: float = 0.0):
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
            raise ProblemError(f"Grid: steps is a whole number of at least 1; received {steps!r}.")
        t_final, t_start = _scalar(t_final), _scalar(t_start)
        earliest = _earliest(t_final)
        if np.shape(getattr(t_final, "initial", 0.0) if decided_bounds(t_final) is not None else 0.0) != ():
            raise ProblemError(f"Grid: there is one final time; received an array of decisions {t_final!r}.")
        if not (_is_finite(t_start) and _is_finite(earliest) and earliest > t_start):
            free = decided_bounds(t_final) is not None
            raise ProblemError(
                f"Grid: t_final must be a finite number after t_start={t_start!r}; received "
                + (f"a decision that may be {earliest!r}: raise its lower bound." if free else f"t_final={t_final!r}.")
            )
        self.t_final = float(t_final) if decided_bounds(t_final) is None else t_final
        self.steps = int(steps)
        self.t_start = float(t_start)

    @property
    def latest(self) -> float:
        """The final time, or the largest one that may be chosen, s."""
        bounds = decided_bounds(self.t_final)
        return float(self.t_final if bounds is None else bounds[1])

    def finer(self, factor: int) -> "Grid":
        """The same time in `factor` times as many steps."""
        return Grid(self.t_final, factor * self.steps, float(self.t_start))

    @property
    def step(self) -> Scalar:
        """Length of one step."""
        return (self.t_final - self.t_start) / self.steps

    @property
    def fractions(self) -> Float[np.ndarray, " instants"]:
        """All instants as fractions of the duration: known whatever the final time is."""
        return np.linspace(0.0, 1.0, self.steps + 1)

    @property
    def times(self) -> Float[Array, " instants"]:
        """All instants."""
        return instants(self.fractions, self.t_start, self.t_final)

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


def _earliest(t_final: Any) -> Any:
    bounds = decided_bounds(t_final)
    return t_final if bounds is None else float(np.min(bounds[0]))


def _scalar(number: Any) -> Any:
    """An array of one known number, without axes, as a float; everything else as it is."""
    is_array = isinstance(number, np.ndarray | jax.Array) and not isinstance(number, Tracer)
    return float(number) if is_array and number.shape == () and number.dtype.kind in "iuf" else number


def _is_finite(number: object) -> bool:
    return isinstance(number, int | float | np.number) and bool(np.isfinite(number))
