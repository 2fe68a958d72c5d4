"""The instants at which a simulation is recorded: a `Grid` of them or, without time, one `Instant`."""

import abc
from typing import Any, Self, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator._core.given import is_masked, whole
from aleator._core.leaves import AbstractLeaf, highest, lowest, realised_shape
from aleator.trajectories import instants


class AbstractGrid(eqx.Module):
    """The instants at which outputs are known: the leading axis of every history. `steps` lie between them."""

    steps: eqx.AbstractVar[int]

    @abc.abstractmethod
    def finer(self, factor: int) -> Self:
        """The same time in `factor` times as many steps."""

    @property
    @abc.abstractmethod
    def step(self) -> Scalar:
        """Length of one step, s; one where there is no time, so that a sum over instants is a value."""

    @property
    @abc.abstractmethod
    def times(self) -> Float[Array, " instants"]:
        """All instants, in seconds."""


@final
class Grid(AbstractGrid):
    """Uniform instants from `t_start` to `t_final`, `steps` steps apart: `steps + 1` instants, in seconds.

    `t_final` may be a `Decision`: a free final time. Trajectories among the inputs fill the grid, however long it is.
    """

    t_final: Any
    steps: int = eqx.field(static=True)
    t_start: Scalar

    def __init__(self, t_final: Any, steps: int, t_start: float = 0.0):
        self.steps = whole("Grid: steps", steps)
        t_final, t_start = _scalar(t_final), _scalar(t_start)
        free = _is_decided(t_final)
        earliest = _earliest(t_final)
        if free and realised_shape(t_final) != ():
            raise ProblemError(f"Grid: there is one final time; received an array of decisions {t_final!r}.")
        if not (_is_finite(t_start) and _is_finite(earliest) and earliest > t_start):
            raise ProblemError(
                f"Grid: t_final must be a finite number after t_start={t_start!r}; received "
                + (f"a decision that may be {earliest!r}: raise its lower bound." if free else f"t_final={t_final!r}.")
            )
        self.t_final = t_final if free else float(t_final)
        self.t_start = float(t_start)

    @property
    def latest(self) -> float:
        """The final time, or the largest one that may be chosen, s."""
        return float(self.t_final if (latest := highest(self.t_final)) is None else latest)

    @override
    def finer(self, factor: int) -> "Grid":
        return self.divided(factor * self.steps)

    def divided(self, steps: int) -> "Grid":
        """The same time in so many steps."""
        return Grid(self.t_final, steps, float(self.t_start))

    @property
    @override
    def step(self) -> Scalar:
        return (self.t_final - self.t_start) / self.steps

    @property
    def fractions(self) -> Float[np.ndarray, " instants"]:
        """All instants as fractions of the duration: known whatever the final time is."""
        return np.linspace(0.0, 1.0, self.steps + 1)

    @property
    @override
    def times(self) -> Float[Array, " instants"]:
        return instants(self.fractions, self.t_start, self.t_final)

    @property
    def duration(self) -> Scalar:
        """From the first instant to the last, s."""
        return self.t_final - self.t_start

    @property
    def node_fractions(self) -> Float[np.ndarray, " nodes"]:
        """The instants and the middles of the steps between them, as fractions of the duration."""
        return np.linspace(0.0, 1.0, 2 * self.steps + 1)

    @property
    def node_times(self) -> Float[Array, " nodes"]:
        """The instants and the middles of the steps between them."""
        return instants(self.node_fractions, self.t_start, self.t_final)

    @property
    def node_weights(self) -> Float[Array, " nodes"]:
        """Weights of Simpson's rule on instants and middles: of order 4, as the default integrator is."""
        weights = np.tile([2.0, 4.0], self.steps + 1)[:-1]
        weights[[0, -1]] = 1.0
        return jnp.asarray(self.step / 6 * weights)


@final
class Instant(AbstractGrid):
    """No time: the one instant, `t = 0`, of a system of algebraic equations. A sum over it is the value itself."""

    steps: int = eqx.field(static=True, default=0)

    @override
    def finer(self, factor: int) -> "Instant":
        return self

    @property
    @override
    def step(self) -> Scalar:
        return 1.0

    @property
    @override
    def times(self) -> Float[Array, " instants"]:
        return jnp.zeros(1)


def _is_decided(t_final: Any) -> bool:
    """Whether a final time is decided."""
    return isinstance(t_final, AbstractLeaf) and not t_final.UNCERTAIN


def _earliest(t_final: Any) -> Any:
    return lowest(t_final) if _is_decided(t_final) else t_final


def _scalar(number: Any) -> Any:
    """An array of one known number, without axes, as a float; everything else as it is."""
    is_array = isinstance(number, np.ndarray | jax.Array) and not isinstance(number, Tracer) and not is_masked(number)
    return float(number) if is_array and number.shape == () and number.dtype.kind in "iuf" else number


def _is_finite(number: Any) -> bool:
    is_real = isinstance(number, int | float | np.number) and not isinstance(number, bool)
    return is_real and bool(np.isfinite(number))
