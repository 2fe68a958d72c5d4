"""Inputs of a system as functions of time."""

import abc
import csv
from pathlib import Path
from typing import Self, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError


class AbstractSignal(eqx.Module):
    """An input of a system as a function of time. It is part of the model: its numbers may be uncertain or decided."""

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        """The value at time `t`."""

    @abc.abstractmethod
    def span(self) -> tuple[float, float]:
        """The first and last time at which the signal is known (infinite if everywhere)."""


@final
class Tabulated(AbstractSignal):
    """A table of times (s) and values, linear between its samples.

    Raises `ProblemError` if the two differ in length, if there are fewer than two samples, if a number is not finite or
    if the times do not increase.
    """

    times: Float[np.ndarray | Array, " samples"]
    values: Float[np.ndarray | Array, " samples"]

    def __init__(self, times: np.ndarray, values: np.ndarray):
        self.times = np.asarray(times, dtype=float)
        self.values = np.asarray(values, dtype=float)
        if self.times.ndim != 1 or self.times.shape != self.values.shape or self.times.size < 2:
            raise ProblemError(
                "Tabulated: expected two vectors of the same length, of at least 2; "
                f"received times {self.times.shape} and values {self.values.shape}."
            )
        if not (np.isfinite(self.times).all() and np.isfinite(self.values).all()):
            raise ProblemError("Tabulated: every time and value must be finite.")
        if not np.all(np.diff(self.times) > 0):
            at = int(np.argmin(np.diff(self.times) > 0)) + 1
            raise ProblemError(f"Tabulated: times must increase, but sample {at} is not after the one before it.")

    @classmethod
    def from_csv(cls, path: str | Path, time: str, value: str) -> Self:
        """Read the columns `time` and `value` of a CSV file; lines that start with `#` are comments."""
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
        names = list(rows[0]) if rows else []
        for name in (time, value):
            if name not in names:
                raise ProblemError(f"{path}: expected a column '{name}'; received {names}.")
        try:
            return cls(*(np.array([float(row[name] or "nan") for row in rows]) for name in (time, value)))
        except ValueError as error:
            raise ProblemError(f"{path}: {error}") from error

    def __call__(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractSignal.__call__`."""
        return jnp.interp(t, self.times, self.values)

    def span(self) -> tuple[float, float]:
        """See `AbstractSignal.span`."""
        return float(self.times[0]), float(self.times[-1])
