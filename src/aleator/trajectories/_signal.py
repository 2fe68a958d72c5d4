"""Functions of time: inputs of a system and prescribed motions."""

import abc
from typing import Any, ClassVar

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import in_library, jax_array
from aleator._core.module import Module


class AbstractSignal(Module):
    """An input of a system as a function of time. It is part of the model: its numbers may be uncertain or decided.

    `unbounded` says that its values have no bound whatever its numbers are, as for a Gaussian process.
    """

    unbounded: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        """The value at time `t`, s."""

    @abc.abstractmethod
    def span(self) -> tuple[float, float]:
        """The first and last time at which the signal is known (infinite if everywhere)."""

    def over(self, t_start: Any, t_final: Any) -> "AbstractSignal":
        """The signal on a grid from `t_start` to `t_final`, s: trajectories are stretched to fill it."""
        del t_start, t_final
        return self

    def sampled(self, fractions: Float[np.ndarray, " n"], t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        """Its values at fixed fractions of the time from `t_start` to `t_final`."""
        return jax.vmap(self.over(t_start, t_final))(instants(fractions, t_start, t_final))


def instants(fractions: Float[np.ndarray, " n"], t_start: Any, t_final: Any) -> Float[Array, " n"]:
    """Fractions of the time from `t_start` to `t_final` as times; 1 is `t_final` to the last bit."""
    # A signal is undefined even a rounding error beyond its end, and so is an adaptive integrator's solution.
    xp, fractions, t_start, t_final = in_library(fractions, t_start, t_final)
    return jax_array(xp.where(fractions < 1, t_start + fractions * (t_final - t_start), t_final))
