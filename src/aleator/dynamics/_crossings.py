"""Events of a realisation: steps that end where a function crosses zero.

A step that meets an event is divided: up to the event, the jump, and the rest, which may meet others. Where the event
is follows first from cubic Hermite interpolation of the function, without derivatives, then from corrections by the
function over its rate. Each of these multiplies errors of the time and of its derivatives of any order by the order of
the error of the step: what the crossing does to derivatives of later states (saltation) comes out by itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from aleator._core.equations import as_time
from aleator.dynamics._evaluation import (
    after_events,
    completed,
    event_levels,
    initial_state,
    observation,
    variables_of,
)
from aleator.dynamics._grid import Grid, Inputs
from aleator.dynamics._record import Asked, Occurrence, Record, zeros
from aleator.dynamics._steps import Steps, signals_within, steps_of
from aleator.dynamics._system import System, state_type
from aleator.dynamics._tableaux import Tableau, square

# Halvings of a step in which an event is sought, and corrections of its time after that.
_HALVED, _CORRECTIONS = 20, 4
# A correction that is a smaller part of a step, or of the time, is rounding. Sides of zero look ahead by as much.
CLOSE = 1e-9
# A jump that leaves a smaller part of the rate of an event leaves it where it is.
_LEAST = 1e-6
# The most events in one step.
_MOST = 12
# What may go wrong.
LOST, MANY, AT_START, TOGETHER, STAYS = range(1, 6)

Vector = Float[Array, " n"]


class Seen(NamedTuple):
    """The first of each event that is looked for: when, s, and states and signals then; NaN before."""

    t: Float[Array, " events"]
    states: Float[Array, "events states"]
    signals: dict[str, Float[Array, "events ..."]]


class Fault(NamedTuple):
    """The first thing that went wrong: what (0: nothing), with which event, and when, s."""

    kind: Int[Array, ""]
    event: Int[Array, ""]
    t: Float[Array, ""]


class Course(NamedTuple):
    """The integration of all steps of a grid; `places`: where its instants are among their beginnings."""

    record: Record
    places: Int[Any, " instants"]
    seen: Seen
    fault: Fault


class _Functions(NamedTuple):
    """What is said at a share of a step of the grid, and a vector there: the rates by this share, the functions of the
    events, and the vectors after each of these; the signals follow from the share alone.
    """

    rates: Callable[[Any, Vector], Vector]
    levels: Callable[[Any, Vector], Float[Array, " events"]]
    after: Callable[[Any, Vector], Float[Array, "events n"]]
    signals: Callable[[Any], dict[str, Array]]


class _State(NamedTuple):
    """How far the integration of one step of the grid is.

    - `vector`: all that is integrated, at the share `begin` of the step; `target`: the share to integrate to;
    - `phase`: 0 on the way to the end of the step, then the number of the correction of the time of `event`;
    - `speed`: the magnitude of the rate of the last event in this step; `left`: how many more there may be;
    - `goes_on`: whether the step is not finished.
    """

    vector: Vector
    begin: Float[Array, ""]
    target: Float[Array, ""]
    phase: Int[Array, ""]
    event: Int[Array, ""]
    speed: Float[Array, ""]
    left: Int[Array, ""]
    goes_on: Bool[Array, ""]
    seen: Seen
    fault: Fault


def course(
    tableau: Tableau,
    system: System,
    grid: Grid,
    inputs: Inputs,
    asked: Asked,
    names: tuple[str, ...],
) -> Course:
    """The record of all steps, which end at the events `names` too; NaN from a fault on."""
    steps, places = steps_of(grid, inputs, [])
    t, now = steps.t[0], {name: values[places[0]] for name, values in steps.first.items()}
    start = initial_state(system, t, now)
    vector, named = ravel_pytree(((*start,), zeros(jax.eval_shape(lambda: asked.rates(system, t, start, now)))))
    size = sum(map(jnp.size, start))
    every = list(system.declared_events)
    which = np.array([every.index(name) for name in names])
    directions = jnp.asarray([system.declared_events[name].direction for name in names])

    def states_of(vector: Vector) -> Any:
        return state_type(system.states)(*named(vector)[0])

    def advance(carried: tuple[Vector, Seen, Fault], step: Steps) -> tuple[Any, dict[str, Array]]:
        vector, seen, fault = carried
        signals = signals_within(grid, inputs, step)

        def rates(share: Any, vector: Vector) -> Vector:
            """By the share of the step."""
            t, u = as_time(step.t + share * step.h), signals(share)
            z = completed(system, t, states_of(vector), u)
            return step.h * ravel_pytree(asked.slopes(system, t, z, u))[0]

        def levels(share: Any, vector: Vector) -> Float[Array, " events"]:
            return event_levels(system, step.t + share * step.h, states_of(vector), signals(share))[which]

        def after(share: Any, vector: Vector) -> Float[Array, "events n"]:
            states = after_events(system, step.t + share * step.h, states_of(vector), signals(share))[which]
            return jax.vmap(lambda one: jnp.concatenate([one, vector[size:]]))(states)

        functions = _Functions(rates, levels, after, signals)
        outputs = asked.at_instant(system, step.t, states_of(vector), step.first)
        zero, none = nothing(vector)
        begin = _State(vector, zero, zero + 1, none, none, zero, none + _MOST, fault.kind == 0, seen, fault)
        end = jax.lax.while_loop(
            lambda state: state.goes_on, lambda state: _moved(tableau, step, functions, directions, state), begin
        )
        return (end.vector, end.seen, end.fault), outputs

    zero, none = nothing(vector)
    signals = {name: zero + jnp.full((len(names), *jnp.shape(one)), jnp.nan) for name, one in now.items()}
    seen = Seen(zero + jnp.full(len(names), jnp.nan), zero + jnp.full((len(names), size), jnp.nan), signals)
    fault = Fault(none, none, zero + jnp.nan)
    (end, seen, fault), history = jax.lax.scan(advance, (vector, seen, fault), steps)
    wanted = sorted(set(names) & asked.events)
    at = jax.tree.map(lambda one: one[np.array([names.index(name) for name in wanted], dtype=int)], seen)

    def outputs(t: Array, states: Vector, now: dict[str, Array]) -> dict[str, Array]:
        return observation(system, t, variables_of(system, named(jnp.concatenate([states, end[size:]]))[0]), now)

    values = jax.vmap(outputs)(*at) if wanted and asked.at_events else {}
    each = (Occurrence(at.t[i], {name: one[i] for name, one in values.items()}) for i in range(len(wanted)))
    record = Record(history, {}, named(end)[1], events=dict(zip(wanted, each, strict=True)))
    is_known = ~jnp.isnan(at.t).any()
    return Course(jax.tree.map(lambda one: jnp.where(is_known, one, jnp.nan), record), places, seen, fault)


def _moved(
    tableau: Tableau, step: Steps, functions: _Functions, directions: Int[Array, " events"], state: _State
) -> _State:
    """One step of the method further: to the end of the step of the grid, or to where an event should be."""
    vector, begin, target = state.vector, state.begin, state.target
    length = target - begin
    end, *slopes = _run(tableau, functions.rates, begin, length, vector)

    def level_and_rate(share: Array, vector: Vector, slope: Vector) -> tuple[Array, Array]:
        return jax.jvp(functions.levels, (share, vector), (jnp.ones(()), slope))

    ends = jnp.stack([begin, target]), jnp.stack([vector, end]), jnp.stack(slopes)
    (level, level_at), (rate, rate_at) = jax.vmap(level_and_rate)(*ends)
    side, crosses = crosses_zero(level, rate, level_at, rate_at, directions)
    parts = jnp.where(crosses, crossing_of(side, level, length * rate, level_at, length * rate_at), jnp.inf)
    is_whole, lands, meets = state.phase == 0, state.phase == _CORRECTIONS + 1, crosses.any()
    event = jnp.where(is_whole, jnp.argmin(parts), state.event)
    correction, place = level_at[event] / rate_at[event], begin + parts[event] * length
    t = step.t + target * step.h

    # Before the step: at an event from the start, or still at the last one. After it: not at the event, or at another.
    stood = is_near(level, rate) & (directions * rate > 0)
    stays = (jnp.abs(level) <= CLOSE * state.speed) & ~(jnp.abs(rate) > _LEAST * state.speed)
    is_off = ~(jnp.abs(correction) <= CLOSE) | (target < begin - CLOSE) | (target > 1 + CLOSE)
    heads = is_near(level_at, rate_at) & ((directions == 0) | (directions * rate_at > 0))
    is_fresh = state.left == _MOST
    kind = jnp.select(
        [
            is_whole & is_fresh & (step.begin == 0) & stood.any(),
            is_whole & ~is_fresh & (begin < 1) & stays[state.event],
            is_whole & meets & (state.left == 0),
            lands & is_off,
            lands & (heads & (jnp.arange(level.size) != event)).any(),
        ],
        [AT_START, STAYS, MANY, LOST, TOGETHER],
        0,
    )
    which = jnp.where(kind == AT_START, jnp.argmax(stood), jnp.where(kind == STAYS, state.event, event))
    new = Fault(kind, which, jnp.where(is_whole, step.t + begin * step.h, t))
    fault = jax.tree.map(lambda old, one: jnp.where(kind > 0, one, old), state.fault, new)

    is_new = lands & (jnp.arange(level.size) == event) & jnp.isnan(state.seen.t)
    now = Seen(t, end[: state.seen.states.shape[1]], functions.signals(target))
    seen = jax.tree.map(
        lambda old, one: jnp.where(is_new.reshape(-1, *[1] * (old.ndim - 1)), one, old), state.seen, now
    )
    is_finished = is_whole & ~meets
    onward = jnp.where(is_finished, end, jnp.where(lands, functions.after(target, end)[event], vector))
    return _State(
        vector=jnp.where(kind > 0, jnp.nan, onward),
        begin=jnp.where(lands, target, begin),
        target=jnp.where(is_whole, jnp.where(meets, place, target), jnp.where(lands, 1.0, target - correction)),
        phase=jnp.where(lands | is_finished, 0, state.phase + 1),
        event=event,
        speed=jnp.where(lands, jnp.abs(rate_at[event]), state.speed),
        left=state.left - lands,
        goes_on=~(is_finished | (kind > 0)),
        seen=seen,
        fault=fault,
    )


def crosses_zero(
    level: Array, rate: Array, level_at: Array, rate_at: Array, directions: Any
) -> tuple[Bool[Array, " n"], Bool[Array, " n"]]:
    """On which side of zero levels begin, and whether they end on the other one, in a direction that counts.

    - `rate`: in a step. The side is that of a moment later: so a start on the ground is no landing.
    """
    side, side_at = level + CLOSE * rate >= 0, level_at + CLOSE * rate_at >= 0
    counts = (directions == 0) | (directions == jnp.where(side_at, 1, -1))
    return side, (side != side_at) & counts & jnp.isfinite(level_at)


def is_near(level: Array, rate: Array) -> Array:
    """Whether levels are zero up to rounding."""
    return jnp.abs(level) <= CLOSE * jnp.abs(rate)


def crossing_of(side: Array, level: Array, rise: Array, level_at: Array, rise_at: Array) -> Array:
    """Where levels that end on the other `side` of zero in an interval cross it, as a part of it: without derivatives.

    By cubic Hermite interpolation, which is as accurate as a step of fourth order. `rise`: the rates by this part.
    """
    level, rise, level_at, rise_at = stop_gradient((level, rise, level_at, rise_at))

    def halved(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        c = (low + high) / 2
        d = 1 - c
        middle = d * d * ((1 + 2 * c) * level + c * rise) + c * c * ((1 + 2 * d) * level_at - d * rise_at)
        is_before = (middle >= 0) != side
        return jnp.where(is_before, low, c), jnp.where(is_before, c, high)

    return jax.lax.fori_loop(0, _HALVED, halved, (jnp.zeros_like(level), jnp.ones_like(level)))[1]


def _run(
    tableau: Tableau, rates: Callable[[Any, Vector], Vector], begin: Any, share: Any, vector: Vector
) -> tuple[Vector, Vector, Vector]:
    """The end of one step of the method, and the rates at its beginning and end."""
    # The last stage is at the end, so that rates are compiled once.
    couplings = jnp.asarray(square((*tableau.couplings, tableau.weights)))
    rows = jnp.arange(len(couplings)), jnp.asarray([*tableau.nodes, 1.0]), couplings

    def stage(stages: Array, row: tuple[Array, Array, Array]) -> tuple[Array, None]:
        index, node, coupling = row
        slope = rates(begin + node * share, vector + share * (coupling @ stages))
        return jax.lax.dynamic_update_index_in_dim(stages, slope, index, 0), None

    stages, _ = jax.lax.scan(stage, jnp.zeros((len(couplings), vector.size)), rows)
    return vector + share * (couplings[-1] @ stages), stages[0], stages[-1]


def nothing(vector: Vector) -> tuple[Float[Array, ""], Int[Array, ""]]:
    """Zeros that follow from a vector: JAX differentiates and vectorises a loop once more for each state that joins."""
    zero = jnp.where(False, vector[0], 0.0)
    return zero, (zero != 0).astype(int)


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
