"""Guesses of states: a function of time, a table, or a solution, from which a simultaneous program starts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.border import meant, real_array, refusal, shown
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem, deterministic, grid_at
from aleator.dynamics import Grid, System, initial_state
from aleator.solution import Solution, States
from aleator.transcription._warm_start import started_from
from aleator.transcription.simultaneous._start import (
    SIMULATED_START,
    AbstractStart,
    interpolated,
    simulated_states,
)
from aleator.uncertainty import realise

Guess: TypeAlias = Callable[[float], Any] | Mapping[str, Any] | np.ndarray | Solution
"""A function of time, in s, that returns the states by name or in the system's order; a table of the same, with the
instants as `"time"`: a dict, an `xarray.Dataset` or a NumPy array with named fields; or a solution."""

_WHO = "Simultaneous: guess"
_TIME = "time"
# A table may end before the last instant by this part of the duration: rounding.
_ROUNDING = 1e-9


def start_of(guess: Guess | None) -> AbstractStart:
    """The start that a guess stands for; that of a simulation for none. Raises `ProblemError` for what is no guess."""
    if guess is None:
        return SIMULATED_START
    if isinstance(guess, Solution):
        return _OfSolution(guess)
    if isinstance(guess, np.ndarray) and guess.dtype.names:
        return _OfTime(_Table.of({name: guess[name] for name in guess.dtype.names}))
    if isinstance(guess, Mapping):
        return _OfTime(_Table.of(guess))
    if callable(guess) and not isinstance(guess, type):
        return _OfTime(guess)
    raise refusal(_WHO, f"a function of time, a table with '{_TIME}' and each state, or a Solution", guess)


@final
@dataclass(frozen=True, eq=False)
class _OfTime(AbstractStart):
    """The same states for all realisations, by a function of time."""

    function: Callable[[float], Any]

    @override
    def states(
        self,
        problem: Problem,
        fractions: Float[np.ndarray, " points"],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "realisations points states"]:
        grid = grid_at(problem, jnp.asarray(decisions))
        assert isinstance(grid, Grid)
        times, shapes = float(grid.t_start) + fractions * float(grid.duration), state_shapes(problem)
        if isinstance(self.function, _Table):
            self.function.refuse_short(times[0], times[-1])
        rows = np.stack([_flat(f"{_WHO} at t = {t:.4g} s", self._at(float(t)), shapes) for t in times])
        return np.repeat(rows[None], len(points), axis=0)

    def _at(self, t: float) -> Any:
        try:
            return self.function(t)
        except AleatorError:
            raise
        except Exception as error:
            raise ProblemError(f"{_WHO} raised {type(error).__name__} at t = {t:.4g} s: {error}.") from error


@final
@dataclass(frozen=True, eq=False)
class _Table:
    """States at some instants, and straight lines between them."""

    times: Float[np.ndarray, " instants"]
    columns: Mapping[str, Float[np.ndarray, "instants ..."]]

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> "_Table":
        """That of arrays by name. Raises `ProblemError` where these are no table over time."""
        names = [name for name in given if name != _TIME]
        try:
            times = real_array(f"{_WHO}, '{_TIME}'", given[_TIME], "instants, in s")
        except KeyError:
            raise refusal(_WHO, f"the instants of a table as '{_TIME}', in s", sorted(map(str, names))) from None
        if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise refusal(f"{_WHO}, '{_TIME}'", "at least two finite instants in ascending order", times)
        columns = {}
        for name in names:
            values = real_array(f"{_WHO}, '{name}'", given[name])
            if values.shape[:1] != times.shape:
                raise ProblemError(
                    f"{_WHO}, '{name}': expected a value for each of {len(times)} instants; received an array of shape "
                    f"{values.shape}."
                )
            columns[name] = values
        return cls(times, columns)

    def refuse_short(self, first: float, last: float) -> None:
        """Refuse a table that does not cover the time from `first` to `last`, s."""
        slack = _ROUNDING * (last - first)
        if self.times[0] > first + slack or self.times[-1] < last - slack:
            raise ProblemError(
                f"{_WHO}: expected a table from {first:.6g} to {last:.6g} s, the time of the grid at the initial "
                f"decisions; received one from {self.times[0]:.6g} to {self.times[-1]:.6g} s."
            )

    def __call__(self, t: float) -> dict[str, np.ndarray]:
        return {name: interpolated(self.times, values, np.array([t]))[0] for name, values in self.columns.items()}


@final
@dataclass(frozen=True, eq=False)
class _OfSolution(AbstractStart):
    """The states of a solution over the fraction of its duration: each realisation's from the nearest one there, or
    from the mean of all where other numbers are uncertain. Decisions are the solution's where it has them.
    """

    solution: Solution

    @override
    def decisions(self, problem: Problem) -> Float[np.ndarray, " n"]:
        return started_from(problem, self.solution, needs_all=False)

    @override
    def states(
        self,
        problem: Problem,
        fractions: Float[np.ndarray, " points"],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "realisations points states"]:
        old = self.solution.problem
        self._refuse_others(old, state_shapes(problem))
        is_alike = old.placements.germ_names == problem.placements.germ_names
        if (known := self.solution.states) is None:
            same, at = (old, points) if is_alike else (deterministic(old), np.zeros((1, 0)))
            found = simulated_states(same, fractions, at, self.solution.vector)
        else:
            table = np.concatenate([_side_by_side(one) for one in known.values.values()], axis=2)
            chosen = table[_nearest(known, points)] if is_alike else table.mean(axis=0, keepdims=True)
            found = np.stack([interpolated(known.fractions, one, fractions) for one in chosen])
        if not np.isfinite(found).all():
            raise refusal(_WHO, "a solution with finite states", self.solution.status)
        return np.broadcast_to(found, (len(points), *found.shape[1:]))

    def _refuse_others(self, old: Problem, shapes: Mapping[str, tuple[int, ...]]) -> None:
        received = state_shapes(old) if isinstance(old.system, System) else {}
        if received != shapes:
            raise ProblemError(
                f"{_WHO}: expected a solution of a system with the states {_told(shapes)}; received one with "
                f"{_told(received)}."
            )


def state_shapes(problem: Problem) -> dict[str, tuple[int, ...]]:
    """The shape of each state of a problem, by name. Nothing is computed."""
    places = problem.placements
    germ, decisions = jnp.zeros(len(places.germ_names)), jnp.asarray(places.vector("initial"))

    def first() -> Any:
        found = realise(problem.simulation, germ, decisions)
        system, start = found.traced, found.start()
        assert isinstance(system, System)
        assert start is not None
        return initial_state(system, *start)

    # The names after tracing: a dict that is traced comes back in alphabetical order.
    return {name: one.shape for name, one in jax.eval_shape(first)._asdict().items()}


def _flat(what: str, given: Any, shapes: Mapping[str, tuple[int, ...]]) -> Float[np.ndarray, " states"]:
    """The states at one instant, side by side. Raises `ProblemError` unless there is a finite value for each."""
    if isinstance(given, np.ndarray | jax.Array) and given.ndim:
        given = list(given)
    if isinstance(given, Sequence) and not isinstance(given, str) and len(given) == len(shapes):
        given = dict(zip(shapes, given, strict=True))
    if not isinstance(given, Mapping):
        raise refusal(what, f"the states {_told(shapes)}, by name or in that order", given)
    for name in given:
        if name not in shapes:
            known = list(shapes)
            raise ProblemError(f"{what}: there is no state {name!r}; expected {known}.{meant(str(name), known)}")
    if missing := [name for name in shapes if name not in given]:
        raise ProblemError(f"{what}: expected all of {list(shapes)}; received none for {missing}.")
    parts = []
    for name, shape in shapes.items():
        value = real_array(f"{what}, '{name}'", given[name])
        if value.shape != shape:
            expected = f"numbers of shape {shape}" if shape else "one number"
            raise ProblemError(f"{what}, '{name}': expected {expected}; received {shown(given[name])}.")
        if not np.isfinite(value).all():
            raise refusal(f"{what}, '{name}'", "finite numbers", given[name])
        parts.append(value.ravel())
    return np.concatenate([np.zeros(0), *parts])


def _nearest(known: States, points: Float[np.ndarray, "realisations germs"]) -> np.ndarray:
    """Which of the known realisations is nearest to each germ point."""
    return np.array([np.square(known.germs - one).sum(axis=1).argmin() for one in points])


def _side_by_side(values: Float[np.ndarray, "realisations points ..."]) -> Float[np.ndarray, "realisations points n"]:
    return values.reshape(*values.shape[:2], -1)


def _told(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"'{name}'{f' of shape {shape}' if shape else ''}" for name, shape in shapes.items()) or "none"
