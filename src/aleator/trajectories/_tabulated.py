"""`Tabulated`: a table of times and values as a signal."""

from pathlib import Path
from typing import Any, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.given import real_array
from aleator._core.leaves import is_leaf, realised_shape
from aleator._core.tables import entry, read_table
from aleator.trajectories._signal import AbstractSignal


@final
class Tabulated(AbstractSignal):
    """A table of times (s) and values, linear between its samples.

    Times are plain numbers. The values may be one array-valued `Decision`, or a list in which any value is a
    distribution or a `Decision`: `Tabulated([0.0, 1.0], [Uniform(2.0, half_width=0.1), 3.0])`. A caller's arrays are
    copied.

    Raises `ProblemError` if the two differ in length, if there are fewer than two samples, if a number is not finite or
    if the times do not increase.
    """

    times: Float[np.ndarray, " samples"]
    values: Any

    def __init__(self, times: Any, values: Any):
        self.times = _numbers("times", times)
        self.values = values if is_leaf(values) else _samples(values)
        length = _shape(self.values)
        if self.times.ndim != 1 or self.times.shape != length or self.times.size < 2:
            raise ProblemError(
                "Tabulated: expected two vectors of the same length, of at least 2; "
                f"received times {self.times.shape} and values {length}."
            )
        plain = [value for value in jax.tree.leaves(self.values, is_leaf=is_leaf) if not is_leaf(value)]
        if not all(np.isfinite(numbers).all() for numbers in [self.times, *plain]):
            raise ProblemError("Tabulated: every time and value must be finite.")
        if not np.all(np.diff(self.times) > 0):
            at = int(np.argmin(np.diff(self.times) > 0)) + 1
            raise ProblemError(f"Tabulated: times must increase, but sample {at} is not after the one before it.")

    @classmethod
    def from_csv(cls, path: str | Path, time: str, value: str) -> Self:
        """Read the columns `time` and `value` of a CSV file; lines that start with `#` are comments.

        Raises `ProblemError` if the file does not exist, is not a table, or does not have each of the two columns once.
        """
        names, rows = read_table("Tabulated.from_csv", path)
        for name in (time, value):
            if names.count(name) != 1:
                raise ProblemError(f"{path}: expected one column '{name}'; received {names}.")
        try:
            return cls(*(np.array([entry(row, names.index(name)) for row in rows]) for name in (time, value)))
        except ValueError as error:
            raise ProblemError(f"{path}: {error}") from error

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, ""]:
        values = (
            jnp.stack([jnp.asarray(value) for value in self.values]) if isinstance(self.values, tuple) else self.values
        )
        return jnp.interp(t, self.times, values)

    @override
    def span(self) -> tuple[float, float]:
        return float(self.times[0]), float(self.times[-1])


def _samples(values: Any) -> np.ndarray | tuple[Any, ...]:
    """An array of numbers or, where some are uncertain or decided, a tuple of single values."""
    if not (isinstance(values, list | tuple) and any(is_leaf(value) for value in values)):
        return _numbers("values", values)
    samples = tuple(value if is_leaf(value) else _numbers("values", value) for value in values)
    for place, sample in enumerate(samples):
        if _shape(sample) != ():
            raise ProblemError(
                f"Tabulated: expected one number in each sample; received shape {_shape(sample)} in sample {place}."
            )
    return samples


def _numbers(name: str, values: Any) -> np.ndarray:
    return real_array(f"Tabulated: {name}", values, "plain numbers")


def _shape(values: Any) -> tuple[int, ...]:
    """The shape of numbers, or of those that replace a distribution (a single one) or a decision on realisation."""
    if isinstance(values, tuple):
        return (len(values),)
    return realised_shape(values)
