"""Signals of this package as inputs of an FMU."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from aleator._core.border import shown
from aleator._core.errors import ProblemError
from aleator.dynamics import Grid
from aleator.foreign._fmu._fmu import Fmu
from aleator.foreign._fmu._inputs import Sampled
from aleator.trajectories import AbstractSignal


def sampled_inputs(fmu: Fmu, grid: Grid, given: Any) -> Sampled:
    """Signals by the names of inputs, sampled at the instants of a grid. Raises `ProblemError` if they do not fit."""
    if not isinstance(given, Mapping | None):
        raise ProblemError(
            f"FMU '{fmu.name}': expected inputs as signals by name, such as {{'force': al.Tabulated(times, values)}}; "
            f"received {shown(given)}."
        )
    given = given or {}
    fmu.variables.of_inputs(given)
    times = np.asarray(grid.times)
    columns = [_sampled(fmu, name, signal, grid) for name, signal in given.items()]
    values = np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
    return Sampled(list(given), times, values)


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
