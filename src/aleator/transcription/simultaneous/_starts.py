"""Where a simultaneous program starts: at states as simulated, or by a guess of them; all else follows from these.

A guess is a function of time, a table, or a solution.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import meant, real_array, refusal, shown
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import AleatorError, ProblemError, SimulationError
from aleator.design import Problem, deterministic, grid_at, unsolved
from aleator.dynamics import ONLY_STATES, STATES, Grid, System, initial_state
from aleator.solution import Solution
from aleator.transcription._warm_start import started_from
from aleator.transcription.simultaneous._layout import Layout, Variables, in_chunks
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._program import Assembled
from aleator.uncertainty import realise

# Steps of a simulation in each of the grid: points of a mesh between instants are interpolated.
_FINER = 4
# States that grow by more than this after the first tenth of the time are those of a system that runs away.
_BEGINNING, _MOST_GROWTH = 10, 1e4

Guess: TypeAlias = Callable[[float], Any] | Mapping[str, Any] | np.ndarray | Solution
"""A function of time, in s, that returns the states by name or in the system's order; a table of the same, with the
instants as `"time"`: a dict, an `xarray.Dataset` or a NumPy array with named fields; or a solution."""

_WHO = "Simultaneous: guess"
_TIME = "time"
# A table may end before the last instant by this part of the duration: rounding.
_ROUNDING = 1e-9


def _simulated(
    problem: Problem, points: Float[Array, "realisations germs"], decisions: Float[Array, " n"]
) -> Float[Array, "realisations instants states"]:
    def one(germ: Array) -> Array:
        return realise(problem.simulation, germ, decisions).record(ONLY_STATES).history[STATES]

    return jax.vmap(one)(points)


SIMULATED = Compiled(_simulated, use=Use.ONCE)


@final
@dataclass(frozen=True)
class Start:
    """Where the programs of a problem start, on any mesh: as simulated, or by a guess of the states.

    - `guess`: a function of time, a table as such a function, or a solution; None for a simulation.
    """

    guess: "Callable[[float], Any] | Solution | None"

    @classmethod
    def of(cls, guess: Guess | None) -> "Start":
        """The start that a guess stands for. Raises `ProblemError` for what is no guess."""
        if isinstance(guess, np.ndarray) and guess.dtype.names:
            guess = {name: guess[name] for name in guess.dtype.names}
        if isinstance(guess, Mapping):
            return cls(_Table.of(guess))
        if guess is None or isinstance(guess, Solution):
            return cls(guess)
        if callable(guess) and not isinstance(guess, type):
            return cls(guess)
        raise refusal(_WHO, f"a function of time, a table with '{_TIME}' and each state, or a Solution", guess)

    def decisions(self, problem: Problem) -> Float[np.ndarray, " n"]:
        """The first decisions: those of a solution where it has them, else the problem's own initial ones."""
        if isinstance(self.guess, Solution):
            return started_from(problem, self.guess, needs_all=False)
        return problem.placements.vector("initial")

    def states(
        self,
        problem: Problem,
        fractions: Float[np.ndarray, " points"],
        points: Float[np.ndarray, "realisations germs"],
        decisions: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "realisations points states"]:
        """The states of realisations at some fractions of the duration, for given decisions."""
        if self.guess is None:
            return _simulated_states(problem, fractions, points, decisions)
        if isinstance(self.guess, Solution):
            return _states_of(self.guess, problem, fractions, points)
        rows = _states_by(self.guess, problem, fractions, decisions)
        return np.repeat(rows[None], len(points), axis=0)


def _simulated_states(
    problem: Problem,
    fractions: Float[np.ndarray, " points"],
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "realisations points states"]:
    """States as they are simulated. If one realisation cannot be simulated at these decisions, or grows beyond reason,
    all rest at their initial states: a program may begin where nothing can be simulated.
    """
    if not problem.is_integrated:
        return np.zeros((len(points), len(fractions), 0))
    assert isinstance(problem.grid, Grid)
    finer = numbers_to_arrays(problem.on_grid(problem.grid.finer(_FINER)))
    states = np.array(SIMULATED(finer, points, decisions))
    begun = np.abs(states[:, : 1 + states.shape[1] // _BEGINNING]).max(axis=(0, 1))
    grown = np.abs(states).max(axis=(0, 1)) > _MOST_GROWTH * np.where(begun > 0, begun, np.inf)
    if not np.isfinite(states).all() or grown.any():
        states = np.repeat(states[:, :1], states.shape[1], axis=1)
    instants = np.linspace(0.0, 1.0, states.shape[1])
    return np.moveaxis(_interpolated(instants, np.moveaxis(states, 1, 0), fractions), 0, 1)


def _states_by(
    function: Callable[[float], Any],
    problem: Problem,
    fractions: Float[np.ndarray, " points"],
    decisions: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "points states"]:
    """The states by a function of time."""
    grid, shapes = grid_at(problem, jax_array(decisions)), state_shapes(problem)
    assert isinstance(grid, Grid)
    times = float(grid.t_start) + fractions * float(grid.duration)
    if isinstance(function, _Table):
        function.refuse_short(times[0], times[-1])

    def at(t: float) -> Any:
        try:
            return function(t)
        except AleatorError:
            raise
        except Exception as error:
            raise ProblemError(f"{_WHO} raised {type(error).__name__} at t = {t:.4g} s: {error}.") from error

    return np.stack([_flat(f"{_WHO} at t = {t:.4g} s", at(float(t)), shapes) for t in times])


def _states_of(
    solution: Solution,
    problem: Problem,
    fractions: Float[np.ndarray, " points"],
    points: Float[np.ndarray, "realisations germs"],
) -> Float[np.ndarray, "realisations points states"]:
    """The states of a solution over the fraction of its duration: each realisation's from the nearest one there, or
    from the mean of all where other numbers are uncertain.
    """
    old, shapes = solution.problem, state_shapes(problem)
    received = state_shapes(old) if isinstance(old.system, System) else {}
    if received != shapes:
        raise ProblemError(
            f"{_WHO}: expected a solution of a system with the states {_listed(shapes)}; received one with "
            f"{_listed(received)}."
        )
    is_alike = old.placements.germ_names == problem.placements.germ_names
    if (known := solution.mesh_states) is None:
        same, at = (old, points) if is_alike else (deterministic(old), np.zeros((1, 0)))
        states = _simulated_states(same, fractions, at, solution.vector)
    else:
        every = [one.reshape(*one.shape[:2], -1) for one in known.values.values()]
        table = np.concatenate(every, axis=2)
        nearest = [np.square(known.germs - one).sum(axis=1).argmin() for one in points] if is_alike else []
        chosen = table[nearest] if is_alike else table.mean(axis=0, keepdims=True)
        states = np.stack([_interpolated(known.fractions, one, fractions) for one in chosen])
    if not np.isfinite(states).all():
        raise refusal(_WHO, "a solution with finite states", solution.status)
    return np.broadcast_to(states, (len(points), *states.shape[1:]))


@final
@dataclass(frozen=True, eq=False)
class _Table:
    """States at some instants, and straight lines between them."""

    times: Float[np.ndarray, " instants"]
    columns: Mapping[str, Float[np.ndarray, "instants ..."]]

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> "_Table":
        """That of arrays by name. Raises `ProblemError` where these are no table over time."""
        names = [name for name in table if name != _TIME]
        try:
            times = real_array(f"{_WHO}, '{_TIME}'", table[_TIME], "instants, in s")
        except KeyError:
            raise refusal(_WHO, f"the instants of a table as '{_TIME}', in s", sorted(map(str, names))) from None
        if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise refusal(f"{_WHO}, '{_TIME}'", "at least two finite instants in ascending order", times)
        columns = {}
        for name in names:
            values = real_array(f"{_WHO}, '{name}'", table[name])
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
        return {name: _interpolated(self.times, values, np.array([t]))[0] for name, values in self.columns.items()}


def _interpolated(
    known: Float[np.ndarray, " n"], values: Float[np.ndarray, "n ..."], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m ..."]:
    """Values between known places, linearly."""
    after = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    share = np.clip((at - known[after - 1]) / (known[after] - known[after - 1]), 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return (1 - share) * values[after - 1] + share * values[after]


def state_shapes(problem: Problem) -> dict[str, tuple[int, ...]]:
    """The shape of each state of a problem, by name. Nothing is computed."""
    places = problem.placements

    def first(germ: Array, decisions: Array) -> Any:
        realised = realise(problem.simulation, germ, decisions)
        system, start = realised.traced, realised.start()
        assert isinstance(system, System)
        assert start is not None
        return initial_state(system, *start)

    germ, decisions = (jax.ShapeDtypeStruct((size,), float) for size in (len(places.germ_names), places.size))
    # The names after tracing: a dict that is traced comes back in alphabetical order.
    return {name: one.shape for name, one in jax.eval_shape(first, germ, decisions)._asdict().items()}


def _flat(what: str, states: Any, shapes: Mapping[str, tuple[int, ...]]) -> Float[np.ndarray, " states"]:
    """The states at one instant, side by side. Raises `ProblemError` unless there is a finite value for each."""
    if isinstance(states, np.ndarray | jax.Array) and states.ndim:
        states = list(states)
    if isinstance(states, Sequence) and not isinstance(states, str) and len(states) == len(shapes):
        states = dict(zip(shapes, states, strict=True))
    if not isinstance(states, Mapping):
        raise refusal(what, f"the states {_listed(shapes)}, by name or in that order", states)
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


def _listed(shapes: Mapping[str, tuple[int, ...]]) -> str:
    return ", ".join(f"'{name}'{f' of shape {shape}' if shape else ''}" for name, shape in shapes.items()) or "none"


def _algebraic(
    problem: Problem,
    points: Float[Array, "realisations germs"],
    places: Float[Array, "places 2"],
    at: tuple[Array, Array, Array, Array],
) -> Float[Array, "realisations places algebraic"]:
    """The algebraic variables at some places, from decisions, duration, and the signals and states there."""
    decisions, duration, signals, states = at
    pointwise = Pointwise.of(problem)
    shared = jnp.append(decisions[pointwise.direct], duration)

    def one(germ: Array, place: Array, signal: Array, state: Array) -> Array:
        return pointwise.algebraic(germ, place, shared, jnp.concatenate([signal, state]))

    inner = jax.vmap(one, in_axes=(None, 0, 0, 0))
    return jax.vmap(inner, in_axes=(0, None, None, 0))(points, places, signals, states)


ALGEBRAIC = Compiled(_algebraic, use=Use.ONCE)


def algebraic_at(
    traced: Problem,
    points: Float[np.ndarray, "realisations germs"],
    places: Float[np.ndarray, "places 2"],
    values: Variables,
    signals: Float[np.ndarray, "places signals"],
    states: Float[np.ndarray, "realisations places states"],
) -> Float[np.ndarray, "realisations places algebraic"]:
    """The algebraic variables at some places: see `_algebraic`."""
    parts = []
    for which, count in in_chunks(places):
        at = values.decisions, values.duration[0], signals[which], states[:, which]
        parts.append(np.asarray(ALGEBRAIC(traced, points, places[which], at))[:, :count])
    return np.concatenate(parts, axis=1)


def started(
    traced: Problem,
    layout: Layout,
    assembled: Assembled,
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "realisations points states"],
) -> Float[np.ndarray, " variables"]:
    """The point of a program at some decisions and states: all else follows from them.

    Raises `SimulationError` where the algebraic variables of a realisation do not follow from its initial state.
    """
    variables, numbers = np.zeros(layout.count), layout.numbers
    variables[numbers.decisions] = decisions
    variables[np.append(numbers.signals.ravel(), numbers.duration)] = assembled.known(variables)
    variables[numbers.states] = states
    if numbers.algebraic.size:
        mesh, values = layout.plan.mesh, layout.view(variables)
        algebraic = algebraic_at(traced, points, mesh.places, values, values.signals, states[:, mesh.sides])
        if (failed := ~np.isfinite(algebraic[:, 0]).all(axis=1)).any():
            first = int(np.argmax(failed))
            reason = unsolved(traced, jax_array(points[first]), jax_array(decisions))
            raise SimulationError(f"{reason} This is collocation point {first + 1} of {len(points)}.")
        variables[numbers.algebraic] = algebraic
    # Each is tied to those before it: what is missing from zero is what it stands for, and what an interval adds.
    ties = assembled.rows.ties
    for some in (numbers.integrals, *layout.stages[1:]):
        these = np.isin(ties.variables, some)
        # What is NaN here makes no start; the rows that are NaN there say where.
        variables[ties.variables[these]] = np.nan_to_num(-assembled.constraints(variables)[ties.rows][these])
        if some is numbers.integrals:
            variables[some] = np.cumsum(variables[some], axis=1)
    return variables
