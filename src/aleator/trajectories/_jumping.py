"""Signals that declare their jumps, tables and step functions; tables in CSV files.

Between jumps they are smooth, so that integrators keep their order if each step sees one piece.
"""

import abc
import csv
from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.arrays import jax_array
from aleator._core.border import content_of, real_array, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_traced, realised_shape, stored_numbers
from aleator.trajectories._signals import AbstractSignal, Fractions, as_array, instants

Tree = TypeVar("Tree")

_SEPARATORS = {";": "semicolons", "\t": "tabs"}


class AbstractJumping(AbstractSignal):
    """A signal that is smooth between its jumps.

    `times`: numbers among which those of its jumps are, s; `piece`: the number of jumps before the piece that it is
    held on, whatever the time is; None if it is not.
    """

    declares_jumps: ClassVar[bool] = True

    times: eqx.AbstractVar[Any]
    piece: eqx.AbstractVar[Any]

    @property
    @abc.abstractmethod
    def pieces(self) -> int:
        """One more than it has jumps."""

    @property
    @abc.abstractmethod
    def jumps(self) -> Float[np.ndarray, " jumps"] | Float[Array, " jumps"]:
        """The times of its jumps, s."""


def _jumps(node: Any) -> bool:
    return isinstance(node, AbstractJumping) and node.pieces > 1


def _is_jumping(node: Any) -> bool:
    return isinstance(node, AbstractJumping)


def jumping_in(signals: Any) -> list[AbstractJumping]:
    """All signals with declared jumps in a model or a part of it, in order."""
    return [node for node in jax.tree.leaves(signals, is_leaf=_is_jumping) if _jumps(node)]


def on_pieces(signals: Tree, pieces: Iterable[Any]) -> Tree:
    """The same signals, each of `jumping_in` held on the piece that follows so many of its jumps."""
    given = iter(pieces)

    def held(node: Any) -> Any:
        if not _jumps(node):
            return node
        one = copy(node)  # its numbers may be traced, and were checked
        object.__setattr__(one, "piece", next(given))
        return one

    return jax.tree.map(held, signals, is_leaf=_is_jumping)


@final
class StepFunction(AbstractJumping):
    """Constant between jumps: `StepFunction([2.0, 3.0], [200.0, 80.0, 0.0])` is 200 until 2 s, then 80, and 0 from 3 s.

    - `times`: of the jumps, s: numbers, distributions or decisions, or one array-valued `Decision`;
    - `levels`: one more than times, likewise.

    Integrators end a step at each jump, wherever it is, and so keep their order; derivatives by the times are exact.
    The level changes to the next one at whichever jump comes next.

    Raises `ProblemError` if the numbers of times and levels do not match, or if known times do not increase.
    """

    times: Any
    levels: Any
    piece: Any = None

    def __init__(self, times: Any, levels: Any):
        self.times = stored_numbers("StepFunction: times", times)
        self.levels = stored_numbers("StepFunction: levels", levels)
        count, levels_shape = realised_shape(self.times), realised_shape(self.levels)
        if len(count) != 1 or not count[0] or levels_shape[:1] != (count[0] + 1,):
            raise ProblemError(
                "StepFunction: expected a list of times and one level more than times, such as "
                f"al.StepFunction([2.0], [1.0, 0.0]); received times {count} and levels {levels_shape}."
            )
        if isinstance(self.times, np.ndarray) and not np.all(np.diff(self.times) > 0):
            raise ProblemError(f"StepFunction: times must increase; received {self.times.tolist()}.")

    @property
    @override
    def pieces(self) -> int:
        return realised_shape(self.levels)[0]

    @property
    @override
    def jumps(self) -> Float[np.ndarray, " jumps"] | Float[Array, " jumps"]:
        return as_array(self.times)

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return as_array(self.levels)[jnp.sum(self.jumps <= t) if self.piece is None else self.piece]


def _row(table: Float[Array, "rows columns"], place: Int[Array, ""]) -> Float[Array, " columns"]:
    return table.at[place].get(mode="promise_in_bounds", wrap_negative_indices=False)


@final
class Tabulated(AbstractJumping):
    """A table of times (s) and values, linear between its samples.

    A time that occurs twice is a jump, from the first value to the second: no step of an integrator crosses it. Times
    are plain numbers (`StepFunction` has jumps at uncertain or decided times). The values may be one array-valued
    `Decision`, or a list in which any value is a distribution or a `Decision`:
    `Tabulated([0.0, 1.0], [Uniform(2.0, half_width=0.1), 3.0])`. A caller's arrays are copied.

    Raises `ProblemError` if the two differ in length, if there are fewer than two samples, if a number is not finite or
    if the times do not increase: the first and the last one occur once, others twice at most.
    """

    times: Float[np.ndarray, " samples"]
    values: Any
    begins: tuple[int, ...] = eqx.field(static=True)  # the samples with which pieces begin
    piece: Any = None

    def __init__(self, times: Any, values: Any):
        self.times = real_array("Tabulated: times", times, "plain numbers")
        refuse_not_finite("Tabulated: times", self.times)
        self.values = stored_numbers("Tabulated: values", values, at=self._instant)
        length = realised_shape(self.values)
        if self.times.ndim != 1 or self.times.shape != length or self.times.size < 2:
            raise ProblemError(
                "Tabulated: expected two vectors of the same length, of at least 2; "
                f"received times {self.times.shape} and values {length}."
            )
        rises = np.diff(self.times)
        ends = np.concatenate([[0], np.flatnonzero(rises == 0) + 1, [self.times.size]])  # of pieces
        alone = np.minimum(ends[1:], self.times.size - 1)[np.diff(ends) < 2]
        if (rises < 0).any() or alone.size:
            at = min(*(np.flatnonzero(rises < 0) + 1), *alone, self.times.size)
            raise ProblemError(
                f"Tabulated: times must increase, but sample {at} is not after the one before it. A jump is two "
                "samples of one time, between others."
            )
        self.begins = tuple(ends[:-1].tolist())

    def _instant(self, place: tuple[int, ...]) -> str:
        """The instant of a value in words, or its number where there are too few times."""
        times = self.times.ravel()
        return f"t = {times[place[0]]:g} s" if place[0] < times.size else f"entry {place[0]}"

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
            return cls(*(numbers_in(rows, names.index(name)) for name in (time, value)))
        except ValueError as error:
            raise ProblemError(f"{path}: {error}") from error

    @property
    @override
    def pieces(self) -> int:
        return len(self.begins)

    @property
    @override
    def jumps(self) -> Float[np.ndarray, " jumps"] | Float[Array, " jumps"]:
        return self.times[np.array(self.begins[1:], dtype=int)]

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, ""]:
        # Not by `jnp.interp`, which is three times as many equations.
        values, after = as_array(self.values), jnp.searchsorted(self.times[1:-1], t, side="right") + 1
        if self.piece is not None:
            first, last = jnp.array(self.begins), jnp.array([*self.begins[1:], len(self.times)])
            after = jnp.clip(after, first[self.piece] + 1, last[self.piece] - 1)
        table = jnp.stack([jnp.asarray(self.times), values], axis=-1)
        (left, low), (right, high) = (_row(table, place) for place in (after - 1, after))
        # Constant outside; `jnp.clip` would halve derivatives at both ends.
        inside = low + (t - left) / (right - left) * (high - low)
        return jnp.where(t < self.times[0], low, jnp.where(t > self.times[-1], high, inside))

    @property
    def is_plain(self) -> bool:
        """Whether nothing in it is uncertain or decided, and it does not jump: NumPy looks it up."""
        return isinstance(self.values, np.ndarray) and self.pieces == 1

    @override
    def sampled(self, fractions: Fractions, t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        times = instants(fractions, t_start, t_final)
        if not self.is_plain or is_traced(times):
            return super().sampled(fractions, t_start, t_final)
        return jax_array(np.interp(times, self.times, self.values))

    @override
    def span(self) -> tuple[float, float]:
        return float(self.times[0]), float(self.times[-1])


def read_table(what: str, path: Any) -> tuple[list[str], list[list[str]]]:
    """The names of the columns of a CSV file, and its rows; lines that start with `#` are comments.

    Raises `ProblemError` if there is no such file or if it is no table; `what` begins the sentence for a wrong path.
    """
    try:
        text = content_of(path).decode("utf-8-sig")
        names, *rows = csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    except TypeError as error:
        raise ProblemError(f"{what}: expected the path of a file; received {path!r}.") from error
    except UnicodeDecodeError as error:
        byte = f"{error.object[error.start]:#x}"
        raise ProblemError(f"{path}: expected text in UTF-8; received the byte {byte}.") from error
    except (OSError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ProblemError(f"{path}: expected a CSV file that can be read; received: {reason}.") from error
    except ValueError as error:
        raise ProblemError(f"{path}: expected a line with names of columns; received an empty file.") from error
    if separator := next((word for mark, word in _SEPARATORS.items() if mark in "".join(names[:1])), ""):
        raise ProblemError(f"{path}: expected commas between columns, and decimal points; received {separator}.")
    for number, row in enumerate(rows, 1):
        if any(one.strip() for one in row[len(names) :]):
            raise ProblemError(
                f"{path}: expected {len(names)} entries in each row, as in the line of names; received {len(row)} in "
                f"row {number}. Numbers have decimal points."
            )
    return names, rows


def numbers_in(rows: list[list[str]], column: int) -> Float[np.ndarray, " rows"]:
    """The numbers in a column of a table. Raises `ValueError`, naming the row, for anything else."""
    numbers = []
    for number, row in enumerate(rows, 1):
        try:
            numbers.append(entry(row, column))
        except ValueError as error:
            raise ValueError(f"row {number}: {error}") from None
    return np.array(numbers)


def entry(row: list[str], column: int) -> float:
    """A number in a row of a table; NaN where the column is missing or empty."""
    text = (row[column] if column < len(row) else "").strip() or "nan"
    if "_" in text:  # which Python takes for a separator of digits
        raise ValueError(f"could not convert string to float: {text!r}")
    return float(text)
