"""Guesses of the states over time: functions, tables, and solutions; what they say at an instant."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.border import meant, real_array, refusal, shown
from aleator._core.errors import ProblemError
from aleator.solution import Solution

Guess: TypeAlias = Callable[[float], Any] | Mapping[str, Any] | np.ndarray | Solution
"""A function of time, in s, that returns the states by name or in the system's order; a table of the same, with the
instants as `"time"`: a dict, an `xarray.Dataset` or a NumPy array with named fields; one of these for each phase by
name; or a solution."""

WHO = "Simultaneous: guess"
_TIME = "time"
# A table may end before the last instant by this part of the duration: rounding.
_ROUNDING = 1e-9

OverTime: TypeAlias = "Callable[[float], Any] | Table"


def over_time(guess: Any) -> "OverTime":
    """A function of time, or a table as such a function. Raises `ProblemError` for anything else."""
    if isinstance(guess, np.ndarray) and guess.dtype.names:
        guess = {name: guess[name] for name in guess.dtype.names}
    if isinstance(guess, Mapping):
        return Table.of(guess)
    if callable(guess) and not isinstance(guess, type):
        return guess
    raise refusal(WHO, f"a function of time, a table with '{_TIME}' and each state, or a Solution", guess)


@final
@dataclass(frozen=True, eq=False)
class Table:
    """States at some instants, and straight lines between them."""

    times: Float[np.ndarray, " instants"]
    columns: Mapping[str, Float[np.ndarray, "instants ..."]]

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> "Table":
        """That of arrays by name. Raises `ProblemError` where these are no table over time."""
        names = [name for name in table if name != _TIME]
        try:
            times = real_array(f"{WHO}, '{_TIME}'", table[_TIME], "instants, in s")
        except KeyError:
            raise refusal(WHO, f"the instants of a table as '{_TIME}', in s", sorted(map(str, names))) from None
        if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise refusal(f"{WHO}, '{_TIME}'", "at least two finite instants in ascending order", times)
        columns = {}
        for name in names:
            values = real_array(f"{WHO}, '{name}'", table[name])
            if values.shape[:1] != times.shape:
                raise ProblemError(
                    f"{WHO}, '{name}': expected a value for each of {len(times)} instants; received an array of shape "
                    f"{values.shape}."
                )
            columns[name] = values
        return cls(times, columns)

    def refuse_short(self, first: float, last: float) -> None:
        """Refuse a table that does not cover the time from `first` to `last`, s."""
        slack = _ROUNDING * (last - first)
        if self.times[0] > first + slack or self.times[-1] < last - slack:
            raise ProblemError(
                f"{WHO}: expected a table from {first:.6g} to {last:.6g} s, the time of the grid at the initial "
                f"decisions; received one from {self.times[0]:.6g} to {self.times[-1]:.6g} s."
            )

    def __call__(self, t: float) -> dict[str, np.ndarray]:
        return {name: interpolated(self.times, values, np.array([t]))[0] for name, values in self.columns.items()}


def interpolated(
    known: Float[np.ndarray, " n"], values: Float[np.ndarray, "n ..."], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m ..."]:
    """Values between known places, linearly."""
    after = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    share = np.clip((at - known[after - 1]) / (known[after] - known[after - 1]), 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return (1 - share) * values[after - 1] + share * values[after]


def flat_states(what: str, states: Any, shapes: Mapping[str, tuple[int, ...]]) -> Float[np.ndarray, " states"]:
    """The states at one instant, side by side. Raises `ProblemError` unless there is a finite value for each."""
    if isinstance(states, np.ndarray | jax.Array) and states.ndim:
        states = list(states)
    if isinstance(states, Sequence) and not isinstance(states, str) and len(states) == len(shapes):
        states = dict(zip(shapes, states, strict=True))
    if not isinstance(states, Mapping):
        raise refusal(what, f"the states {listed(shapes)}, by name or in that order", states)
    for name in states:
        if name not in shapes:
            known = list(shapes)
            raise ProblemError(f"{what}: there is no state {name!r}; expected {known}.{meant(str(name), known)}")
    if missing := [name for name in shapes if name not in states]:
        raise ProblemError(f"{what}: expected all of {list(shapes)}; received none for {missing}.")
    parts = []
    for name, shape in shapes.items():
        value = real_array(f"{what}, '{name}'", states[name])
        if value.shape != shape:
            expected = f"numbers of shape {shape}" if shape else "one number"
            raise ProblemError(f"{what}, '{name}': expected {expected}; received {shown(states[name])}.")
        if not np.isfinite(value).all():
            raise refusal(f"{what}, '{name}'", "finite numbers", states[name])
        parts.append(value.ravel())
    return np.concatenate([np.zeros(0), *parts])


def listed(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"'{name}'{f' of shape {shape}' if shape else ''}" for name, shape in shapes.items()) or "none"
