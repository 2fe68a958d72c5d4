"""Inputs of an FMU that vary with time: known at the instants of a grid, straight in between."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.given import shown
from aleator.dynamics import Grid
from aleator.foreign._fmu._fmu import Fmu
from aleator.foreign._fmu._instance import Instance
from aleator.trajectories import AbstractSignal


class Inputs(NamedTuple):
    """Values of inputs at instants, shape (instants, inputs)."""

    variables: list[Any]
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
    def first(self) -> dict[Any, float]:
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


def sampled_inputs(fmu: Fmu, grid: Grid, given: Any) -> Inputs:
    """Signals by the names of inputs, sampled at the instants of a grid. Raises `ProblemError` if they do not fit."""
    if not isinstance(given, Mapping | None):
        raise ProblemError(
            f"FMU '{fmu.name}': expected inputs as signals by name, such as {{'force': al.Tabulated(times, values)}}; "
            f"received {shown(given)}."
        )
    given = given or {}
    variables = fmu.variables.of_inputs(given)
    times = np.asarray(grid.times)
    columns = [_sampled(fmu, name, signal, grid) for name, signal in given.items()]
    values = np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
    return Inputs(variables, times, values)


def _sampled(fmu: Fmu, name: str, signal: Any, grid: Grid) -> np.ndarray:
    who = f"FMU '{fmu.name}', input '{name}'"
    if not isinstance(signal, AbstractSignal):
        raise ProblemError(
            f"{who}: expected a signal, such as al.Tabulated(times, values); received {shown(signal)}. A constant is "
            "given among the parameters."
        )
    first, last = signal.over(grid.t_start, grid.t_final).span()
    if float(grid.t_start) < first or float(grid.t_final) > last:
        raise ProblemError(
            f"{who} is known from {first:g} to {last:g} s; expected from {grid.t_start:g} to {grid.t_final:g} s."
        )
    try:
        values = np.asarray(signal.sampled(grid.fractions, grid.t_start, grid.t_final))
    except (TypeError, jax.errors.JAXTypeError) as error:
        raise ProblemError(f"{who}: expected a signal of known numbers; received {shown(signal)}.") from error
    if values.shape != (len(grid.fractions),) or not np.isfinite(values).all():
        raise ProblemError(f"{who}: expected one finite number at each instant; received shape {values.shape[1:]}.")
    return values
