"""What a simulation is asked to record, and its record; that of systems without states, whose outputs at an instant
depend only on the inputs there.
"""

import math
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, NamedTuple, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_jaxpr
from jax.flatten_util import ravel_pytree
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float, Int

from aleator._core.arrays import Pytree
from aleator._core.equations import TracedFunction, derived, is_still
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.dynamics._evaluation import derivative, derivative_and_observation, initial_state, observation
from aleator.dynamics._grid import Grid, Inputs, sampled
from aleator.dynamics._steps import steps_of
from aleator.dynamics._system import System
from aleator.trajectories import has_jumps, instants

History: TypeAlias = dict[str, Float[Array, "instants ..."]]
Integrand: TypeAlias = Callable[[Mapping[str, Array]], Float[Array, "..."]]
"""A function of the outputs at one time."""
Fold: TypeAlias = Callable[[Any, dict[str, Array]], tuple[Any, dict[str, Array]]]
"""From what is carried from instant to instant (None before the first) and the outputs there: what is carried on, and
what is recorded in the place of these outputs."""
Fractions: TypeAlias = Float[np.ndarray | Array, " n"]
STATES = "states"
Take: TypeAlias = Callable[[System, Any, Any, dict[str, Array]], Pytree]


class Asked(NamedTuple):
    """What a simulation is asked to record.

    - `instants`: the outputs to record at every instant, by name; None for all;
    - `nodes`: those of them to record at the midpoints of the steps too, for statistics that are integrated over time;
    - `integrands`: functions integrated over time along the realisation, as accurately as its states; `integrated`: the
      outputs that each depends on;
    - `states`: whether to record the states too, side by side, as `STATES`;
    - `fold`: what is made of the outputs at every instant instead of keeping them, where `Simulation.folds`;
    - `events`: those whose first occurrence is needed, without which nothing is known of a realisation; `at_events`:
      the outputs at these; `multipliers`: whether the monodromy matrix of a cycle is;
    - `courses`: by phase (`""` where there are none), the states, side by side, from which each of so many equal parts
      of its time is simulated, or all of it where an event ends it; None for one simulation from the first instant.
      Integrators are asked for one part at a time;
    - `directions`: in so many the record is differentiated at once.
    """

    instants: frozenset[str] | None = None
    nodes: frozenset[str] = frozenset()
    integrands: tuple[Integrand, ...] = ()
    integrated: tuple[frozenset[str], ...] = ()
    states: bool = False
    fold: Fold | None = None
    courses: Mapping[str, Float[Array, "parts states"]] | None = None
    events: frozenset[str] = frozenset()
    at_events: frozenset[str] = frozenset()
    multipliers: bool = False
    directions: int = 0

    @property
    def outputs(self) -> frozenset[str] | None:
        """All outputs that are needed at any time; None for all."""
        if self.instants is None:
            return None
        return self.instants.union(self.nodes, *self.integrated, self.at_events)

    def unfolded(self, outputs: dict[str, Any]) -> Any:
        """What is carried to the first instant, of which the outputs or their shapes are told."""
        if (fold := self.fold) is None:
            return ()
        carried = jax.eval_shape(lambda outputs: fold(None, outputs)[0], outputs)
        return jnp.asarray(True), jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), carried)

    def folded(self, carried: Any, outputs: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
        """What is carried on from an instant, and what is recorded of the outputs there: without a fold, all."""
        if self.fold is None:
            return (), outputs
        is_first, before = carried
        begun, further = self.fold(None, outputs), self.fold(before, outputs)
        on, recorded = jax.tree.map(lambda *both: jnp.where(is_first, *both), begun, further)
        return (jnp.asarray(False), on), recorded

    def at_instant(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> dict[str, Array]:
        """What is recorded at an instant of the grid."""
        return self._recorded(system, z, {} if self.instants == set() else observation(system, t, z, now))

    def at_node(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> dict[str, Array]:
        """What is recorded at the midpoint of a step, and at its ends."""
        return chosen(system, observation(system, t, z, now), self.nodes)

    def everything(
        self, system: System, t: Any, z: Any, now: dict[str, Array]
    ) -> tuple[Any, tuple[Array, ...], dict[str, Array]]:
        """The rates of the states, the integrands, and what is recorded at an instant of the grid."""

        def at(
            system: System, t: Any, z: Any, now: dict[str, Array]
        ) -> tuple[Any, tuple[Array, ...], dict[str, Array]]:
            slopes, outputs = derivative_and_observation(system, t, z, now)
            return slopes, tuple(one(outputs) for one in self.integrands), self._recorded(system, z, outputs)

        return self._through_states(at, system, t, z, now)

    def _recorded(self, system: System, z: Any, outputs: dict[str, Array]) -> dict[str, Array]:
        recorded = chosen(system, outputs, self.instants)
        if not (self.states and system.states):
            return recorded
        return recorded | {STATES: jnp.concatenate([jnp.ravel(one) for one in z[: len(system.states)]])}

    def rates(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> tuple[Array, ...]:
        """The integrands at one time."""
        if not self.integrands:
            return ()
        outputs = observation(system, t, z, now)
        return tuple(one(outputs) for one in self.integrands)

    def slopes(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> tuple[Any, tuple[Array, ...]]:
        """The rates of the states, and the integrands, at one time."""

        def at(system: System, t: Any, z: Any, now: dict[str, Array]) -> tuple[Any, tuple[Array, ...]]:
            if not self.integrands:
                return derivative(system, t, z, now), ()
            focused = system.focused(frozenset().union(*self.integrated))
            slopes, outputs = derivative_and_observation(focused, t, z, now)
            return slopes, tuple(one(outputs) for one in self.integrands)

        return self._through_states(at, system, t, z, now)

    def _through_states(self, at: Take, system: System, t: Any, z: Any, now: dict[str, Array]) -> Pytree:
        """What is taken at one time: of more states than directions, there are no fewer numbers that change."""
        few = sum(map(jnp.size, jax.tree.leaves(z))) < self.directions
        return by_few_numbers(at, self.directions if few else 0, system, t, z, now)


ONLY_STATES = Asked(frozenset(), states=True)


class Occurrence(NamedTuple):
    """The first time at which an event happens, s, and outputs then: those before its jump."""

    t: Float[Array, ""]
    outputs: dict[str, Array]


class Record(NamedTuple):
    """What a simulation recorded.

    - `history`: outputs at every instant, shape (instants, ...); `nodes`: outputs at every instant and at the midpoint
      of every step, shape (2 steps + 1, ...);
    - `integrals`: in the order of the integrands; `folded`: what a fold carried to the last instant;
    - `events`: the first occurrence of each event asked for; `grid`: of the realisation; `monodromy`: the derivatives
      of the states after one cycle by those before it.
    """

    history: History
    nodes: History
    integrals: tuple[Float[Array, "..."], ...]
    folded: Any = ()
    events: dict[str, Occurrence] | None = None
    grid: Any = None
    monodromy: Any = ()

    @property
    def outputs(self) -> History:
        """The history, with the instants as `"time"` where an event ends the grid."""
        return {**self.grid.times_told, **self.history}

    def thinned(self, parts: int) -> "Record":
        """The record of a grid with so many times fewer steps."""
        every = slice(None, None, parts)
        history = {name: values[every] for name, values in self.history.items()}
        # Between two instants of the finer grid lies one more node, so that nodes are as many apart.
        nodes = {name: values[every] for name, values in self.nodes.items()}
        return self._replace(history=history, nodes=nodes, grid=self.grid.coarser(parts))


def zeros(shapes: Pytree) -> Pytree:
    """Zeros of the shapes of something that was not computed."""
    return jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)


def nothing(*numbers: Pytree) -> tuple[Float[Array, ""], Int[Array, ""]]:
    """Zeros that follow from some numbers: JAX differentiates and vectorises a loop again for each state that joins."""
    real = jax.tree.leaves(eqx.filter(numbers, eqx.is_inexact_array))
    first = (one.ravel() if one.size <= 1 else one.ravel()[:1] for one in real)
    every = jnp.concatenate([jnp.zeros(1), *first])
    zero = jax.lax.select(jnp.zeros(every.shape, bool), every, jnp.zeros(every.shape)).sum()
    return zero, (zero != 0).astype(int)


def chosen(system: Any, outputs: dict[str, Array], only: Collection[str] | None) -> dict[str, Array]:
    """The outputs that are asked for. Raises `ProblemError` for any that the system does not have."""
    if only is None:
        return outputs
    if not set(only) <= set(outputs):
        raise ProblemError(
            f"{system.title}: expected in `only` a list of some of the outputs {list(outputs)}; "
            f"received {sorted(only)!r}."
        )
    return {name: value for name, value in outputs.items() if name in only}


@final
class Known(Module):
    """The data at each instant as one row of numbers: the time, then all inputs side by side.

    - `rows`: shape (instants, numbers); `inputs`: the shape of each input with its name, in order.
    """

    rows: Float[Array, "instants numbers"]
    inputs: tuple[tuple[str, tuple[int, ...]], ...] = eqx.field(static=True)

    def unpack(self, row: Float[Array, " numbers"]) -> tuple[Array, dict[str, Array]]:
        """The time and the inputs of one row."""
        values, start = {}, 1
        for name, shape in self.inputs:
            size = math.prod(shape)
            values[name] = row[start : start + size].reshape(shape)
            start += size
        return row[0], values


def known_at(inputs: Inputs, grid: Grid, fractions: Fractions | None = None) -> Known:
    """The data at each instant of a grid, or at some fractions of it; `inputs` include the system's own signals."""
    fractions = grid.fractions if fractions is None else fractions
    return known_of(instants(fractions, grid.t_start, grid.t_final), sampled(inputs, grid, fractions))


def known_of(times: Float[Array, " instants"], at: Mapping[str, Float[Array, "instants ..."]]) -> Known:
    """The data of some times and the inputs there."""
    columns = [values.reshape(len(values), -1) for values in at.values()]
    rows = jnp.concatenate([times[:, None], *columns], axis=1)
    return Known(rows, tuple((name, values.shape[1:]) for name, values in at.items()))


def observed_at(system: System, known: Known, row: Float[Array, " numbers"]) -> dict[str, Array]:
    """The outputs of a system without states at one row of data."""
    t, now = known.unpack(row)
    return observation(system, t, initial_state(system, t, now), now)


def observed(system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
    """The record of a system without states; `inputs` include its own signals.

    Integrals are taken by Simpson's rule, which sees midpoints of steps.
    """

    def over(known: Known, take: Take) -> Pytree:
        def at(realised: System, row: Array) -> Pytree:
            t, now = known.unpack(row)
            return take(realised, t, initial_state(realised, t, now), now)

        return jax.vmap(lambda row: by_few_numbers(at, asked.directions, system, row))(known.rows)

    history = over(known_at(inputs, grid), asked.at_instant)
    if not (asked.nodes or asked.integrands):
        return Record(history, {}, ())
    middles = known_at(inputs, grid, grid.node_fractions)
    nodes = over(middles, asked.at_node) if asked.nodes else {}
    if asked.integrands and has_jumps(inputs):
        (t, h, first, (middle,), last, *_), _ = steps_of(grid, inputs, [0.5])
        sides = ((t, first), (t + h / 2, middle), (t + h, last))
        every = zip(*(over(known_of(*one), asked.rates) for one in sides), strict=True)
        integrals = tuple(jnp.tensordot(h / 6, one + 4 * two + three, axes=1) for one, two, three in every)
    else:
        rates = over(middles, asked.rates) if asked.integrands else ()
        integrals = tuple(jnp.tensordot(grid.node_weights, one, axes=1) for one in rates)
    return Record(history, nodes, integrals)


def by_few_numbers(function: Callable[..., Pytree], directions: int, *arguments: Pytree) -> Pytree:
    """`function(*arguments)`, whose derivatives in many `directions` are those by the numbers that change, if these are
    fewer, multiplied by how they change: the chain rule in the order that is cheap for many decisions.
    """
    traced = TracedFunction(function, *arguments) if directions else None
    if traced is None or any(isinstance(one, Tracer) for one in traced.closed.consts):
        return function(*arguments)
    equations = traced.closed.jaxpr
    sources = [dce_jaxpr(equations, [*row])[1] for row in np.eye(len(equations.outvars), dtype=bool)]
    results = partial(eval_jaxpr, equations, traced.closed.consts)

    def tangent(numbers: tuple[Array, ...], changes: tuple[Any, ...]) -> tuple[list[Array], list[Array]]:
        changing = [i for i, change in enumerate(changes) if any(each[i] for each in sources) and not is_still(change)]
        here = [numbers[i] for i in changing]

        def of(here: list[Array]) -> list[Array]:
            every = dict(enumerate(numbers)) | dict(zip(changing, here, strict=True))
            return results(*every.values())

        if sum(map(jnp.size, here)) >= directions:
            return jax.jvp(of, (here,), ([changes[i] for i in changing],))
        row, restored = ravel_pytree([jnp.zeros(jnp.shape(one)) for one in here])
        values, by_number = jax.linearize(of, here)
        owner = np.repeat(changing, [*map(jnp.size, here)])

        def along(slope: Array, source: list[bool]) -> Array:
            """Through those numbers alone on which it depends: what is the same for all realisations remains so."""
            own = [i for i in changing if source[i]]
            change, _ = ravel_pytree([changes[i] for i in own])
            return jnp.tensordot(change, slope[np.isin(owner, own)], axes=1)

        return values, [*map(along, jax.vmap(lambda row: by_number(restored(row)))(jnp.eye(row.size)), sources)]

    evaluated = jax.custom_jvp(results)
    evaluated.defjvp(derived(tangent), symbolic_zeros=True)
    values = evaluated(*traced.leaves(arguments))
    return eqx.combine(jax.tree.unflatten(traced.results, values), traced.rest)
