"""Inputs of an FMU that vary with time: known at the instants of a grid, straight in between."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu._instance import Instance
from aleator.foreign._fmu._variables import Variable


class Sampled(NamedTuple):
    """Names and values, shape (instants, inputs), of inputs at instants."""

    names: list[str]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]


class Inputs(NamedTuple):
    """Values of inputs at instants, shape (instants, inputs)."""

    variables: list[Variable]
    times: Float[np.ndarray, " instants"]
    values: Float[np.ndarray, "instants inputs"]

    @property
    def references(self) -> list[int]:
        """By which the FMU knows them."""
        return [one.valueReference for one in self.variables]

    def at(self, t: float) -> Float[np.ndarray, " inputs"]:
        """The values at a time."""
        return np.array([np.interp(t, self.times, column) for column in self.values.T], dtype=float)

    @property
    def first(self) -> dict[Variable, float]:
        """The values at the start, by variable."""
        return dict(zip(self.variables, self.values[0].tolist(), strict=True))

    def apply(self, instance: Instance, t: float) -> None:
        """Set the values at a time."""
        if self.references:
            instance.set(self.references, self.at(t))

    def kink_after(self, t: float) -> float:
        """The next instant at which their slopes change; inf without inputs."""
        later = self.times[self.times > t]
        return float(later[0]) if self.references and len(later) else np.inf
