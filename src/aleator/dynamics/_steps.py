"""The steps of a grid, each with the signals on its own side of every jump; and what takes them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator.dynamics._grid import Grid, Inputs, sampled
from aleator.dynamics._system import System
from aleator.trajectories import (
    AbstractSignal,
    Tabulated,
    before_jumps,
    has_jumps,
    instants,
    jumping_in,
    on_pieces,
    piecewise_in,
)

Vector = Float[Array, " n"]
Rates = Callable[[Any, Vector], Vector]
"""The rates of a vector at a share of a step of the grid, by this share; zero at a solution for algebraic variables."""


class Sizes(NamedTuple):
    """How many of the numbers of a vector are states, algebraic variables and integrals, in this order."""

    states: int
    algebraic: int
    integrals: int

    @property
    def unknowns(self) -> int:
        """Those that rates depend on."""
        return self.states + self.algebraic

    @property
    def has_rate(self) -> Float[np.ndarray, " n"]:
        """1 for those with a rate, 0 for algebraic variables."""
        return np.repeat([1.0, 0.0, 1.0], self)


class Pace(NamedTuple):
    """How an adaptive method goes on.

    - `h`: the length to try next, s; `left`: how many more steps may be tried in all;
    - `length`: of the step of the grid, s; `shortest`: the shortest step that is tried in it, s.
    """

    h: Float[Array, ""]
    left: Int[Array, ""]
    length: Float[Array, ""]
    shortest: Float[Array, ""]

    @property
    def goes_on(self) -> Bool[Array, ""]:
        """Whether there is another step."""
        return (self.left > 0) & (self.h > self.shortest)


class Step(NamedTuple):
    """The end of a step of a method.

    - `slopes`: the rates at its beginning and end, where they are known; `is_close`: whether its error is small enough;
      `pace`: after it.
    """

    end: Vector
    slopes: Float[Array, "2 n"] | None = None
    is_close: Any = True
    pace: Pace | None = None


class Method(Protocol):
    """What takes steps: an integrator. `carries_algebraic`: whether algebraic variables are among its unknowns."""

    @property
    def carries_algebraic(self) -> bool: ...

    def begun(self, grid: Grid) -> Pace | None:
        """The pace at first; None where steps are those of the grid."""
        ...

    def step(self, rates: Rates, begin: Any, share: Any, vector: Vector, sizes: Sizes, pace: Pace | None) -> Step:
        """A step from one share of a step of the grid on, over another."""
        ...


class Steps(NamedTuple):
    """Steps one after the other, with the signals that each sees: at a jump, those on its own side.

    After the last one comes a step of no length, so that one begins at each instant.

    - `t`, `h`: when each begins and how long it is, s; `first`, `last`: signals at its ends; `between`: at each of
      some fractions inside;
    - `begin`, `length`: both as fractions of the duration; `pieces`: on which each signal with declared jumps is.
    """

    t: Float[Array, " steps"]
    h: Float[Array, " steps"]
    first: dict[str, Array]
    between: list[dict[str, Array]]
    last: dict[str, Array]
    begin: Float[Array, " steps"]
    length: Float[Array, " steps"]
    pieces: list[Int[Array, " steps"]]


def steps_of(grid: Grid, inputs: Inputs, inner: Sequence[float]) -> tuple[Steps, Int[Any, " instants"]]:
    """The steps of a grid, with signals at `inner` fractions of each, and where among these its instants are.

    A declared jump divides the step in which it lies; so does a node of a control, where an event ends the grid.
    """
    if is_divided(grid, inputs):
        return _divided(grid, inputs, inner)
    return _whole(grid, inputs, inner), np.arange(grid.steps + 1)


def _places(grid: Grid, nodes: Sequence[float]) -> list[Float[np.ndarray, " instants"]]:
    """Some fractions of each step as fractions of the time."""
    lengths = np.diff(grid.fractions, append=1.0)
    return [grid.fractions + node * lengths for node in nodes]


@final
class LookedUp(AbstractSignal):
    """A signal of which the values at some fractions of each step of a grid are known, `rows` of each."""

    signal: AbstractSignal
    nodes: tuple[float, ...] = eqx.field(static=True)
    rows: tuple[Float[Array, "instants ..."], ...]

    @classmethod
    def on(cls, grid: Grid, signal: AbstractSignal, nodes: tuple[float, ...]) -> "LookedUp":
        """That of a grid with known numbers."""
        each = _places(grid, nodes)
        return cls(signal, nodes, tuple(signal.sampled(one, grid.t_start, grid.t_final) for one in each))

    def fits(self, grid: Grid, nodes: tuple[float, ...]) -> bool:
        """Whether its values are those that are needed; parts of a grid have other steps."""
        return self.nodes == nodes and len(self.rows[0]) == grid.steps + 1

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        return self.signal(t)

    @override
    def over(self, t_start: Any, t_final: Any) -> AbstractSignal:
        return self.signal.over(t_start, t_final)

    @override
    def sampled(self, fractions: Any, t_start: Any, t_final: Any) -> Float[Array, "n ..."]:
        return self.signal.sampled(fractions, t_start, t_final)


def tables_looked_up(grid: Grid, inputs: Inputs, nodes: tuple[float, ...]) -> dict[str, LookedUp]:
    """The tables among some inputs in which nothing is uncertain or decided."""
    tables = {name: one for name, one in inputs.items() if isinstance(one, Tabulated) and one.is_plain}
    return {name: LookedUp.on(grid, one, nodes) for name, one in tables.items()}


def is_divided(grid: Grid, inputs: Inputs) -> bool:
    """Whether steps are divided at times that follow from the numbers."""
    return bool(jumping_in(inputs)) or (grid.until is not None and bool(piecewise_in(inputs)))


def _whole(grid: Grid, inputs: Inputs, inner: Sequence[float]) -> Steps:
    """The steps of a grid that ends one at each jump."""
    count, lengths = grid.steps + 1, np.diff(grid.fractions, append=1.0)
    nodes = 0.0, *inner, 1.0
    every = _places(grid, nodes)
    # A table or a spline is looked up once for all stages, if it has not been.
    known = {name: one.rows for name, one in inputs.items() if isinstance(one, LookedUp) and one.fits(grid, nodes)}
    others = sampled({name: one for name, one in inputs.items() if name not in known}, grid, np.concatenate(every))
    known |= {name: [rows[i * count : (i + 1) * count] for i in range(len(every))] for name, rows in others.items()}
    first, *between, last = ({name: known[name][i] for name in inputs} for i in range(len(every)))
    if has_jumps(inputs):
        last = sampled(before_jumps(inputs), grid, every[-1])
    h = jnp.asarray(grid.step * (lengths > 0))
    return Steps(grid.times, h, first, between, last, jnp.asarray(grid.fractions), jnp.asarray(lengths), [])


def _divided(grid: Grid, inputs: Inputs, inner: Sequence[float]) -> tuple[Steps, Int[Array, " instants"]]:
    """The steps of a grid with one more for each declared jump or node, and where among these its instants are.

    The jumps may be anywhere, in any order, so that the steps that they divide are data. Each step is told by its rank
    on which piece of a signal it is: times differ by rounding, and a step of no length has a side too, that of the
    derivative by the time of the jump.
    """
    jumps = [(one.jumps - grid.t_start) / grid.duration for one in jumping_in(inputs)]
    # All signals fill the grid to its latest end.
    nodes = [] if grid.until is None else [np.array(one.nodes[1:-1]) for one in piecewise_in(inputs)]
    nodes = [one * (grid.latest - grid.t_start) / grid.duration for one in nodes]
    every = jnp.concatenate([*jumps, *nodes, jnp.asarray(grid.fractions)])
    order = jnp.argsort(every)  # stable: outputs at a jump are those of the step that begins there
    ends, ranks = jnp.clip(every[order], 0.0, 1.0), jnp.argsort(order)
    *own, places = jnp.split(ranks, np.cumsum([one.size for one in (*jumps, *nodes)]))
    steps = np.arange(every.size)
    pieces = [jnp.sum(one[None] <= steps[:, None], axis=1) for one in own[: len(jumps)]]

    def seen(first: Array, length: Array, pieces: list[Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        held = on_pieces(inputs, pieces)
        inside = sampled(held, grid, first + length * np.array([0.0, *inner]))
        return inside, _at(before_jumps(held), grid, first + length)

    lengths = jnp.diff(ends, append=ends[-1:])
    inside, last = jax.vmap(seen)(ends, lengths, pieces)
    first, *between = ({name: rows[:, i] for name, rows in inside.items()} for i in range(len(inner) + 1))
    times = instants(ends, grid.t_start, grid.t_final)
    h = jnp.asarray(grid.duration) * lengths
    return Steps(times, h, first, between, last, ends, lengths, pieces), places


def signals_within(grid: Grid, inputs: Inputs, step: Steps) -> Callable[[Any], dict[str, Array]]:
    """All signals at a share of one step, on its side of every jump."""
    if not inputs:
        return lambda _: {}
    held = on_pieces(inputs, step.pieces) if step.pieces else inputs

    def at(share: Any) -> dict[str, Array]:
        place = step.begin + share * step.length
        inside = _at(held, grid, place)
        if not has_jumps(inputs):
            return inside
        return jax.tree.map(lambda *sides: jnp.where(share < 1, *sides), inside, _at(before_jumps(held), grid, place))

    return at


def _at(signals: Inputs, grid: Grid, fraction: Any) -> dict[str, Array]:
    return {name: values[0] for name, values in sampled(signals, grid, fraction[None]).items()}


def watched(system: System, grid: Grid, events: frozenset[str]) -> tuple[str, ...]:
    """The events at which steps have to end: those with a jump, and those asked for; not the one that ends the grid."""
    return tuple(
        name
        for name, event in system.declared_events.items()
        if name != grid.until and (event.jump is not None or name in events)
    )


def needed(system: System, grid: Grid, events: frozenset[str]) -> tuple[str, ...]:
    """The same with the event that ends the grid, last."""
    return (*watched(system, grid, events), *([] if grid.until is None else [grid.until]))
