"""Events of a realisation: steps that end where a function crosses zero.

A step that meets an event is divided: up to the event, the jump, and the rest, which may meet others. Newton's method
finds the event, by the function over its rate at the end of a shorter and shorter step; where it would leave the
interval that is known to hold the first event, this is halved. Each correction multiplies errors of the time and of its
derivatives of any order by the order of the error of the step: what the crossing does to derivatives of later states
(saltation) comes out by itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from aleator._core.equations import as_time, loop_while_any
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

# Steps of the search for an event at most, and corrections of its time once it is found, for derivatives.
_SEARCHED, _CORRECTIONS = 24, 4
# Halvings of a step in which an event is sought between instants.
_HALVED = 20
# A correction that is a smaller part of a step, or of the time, is rounding. Sides of zero look ahead by as much.
CLOSE = 1e-9
# A jump that leaves a smaller part of the rate of an event leaves it where it is.
_LEAST = 1e-6
# The most events in one step.
_MOST = 12
# What may go wrong.
LOST, MANY, TOGETHER, STAYS, AT_START = range(1, 6)
# The phase of a step of the grid that is finished; less the number of what went wrong.
_FINISHED = -1

Vector = Float[Array, " n"]


class Seen(NamedTuple):
    """The first of each event that is noted: when, s, and states and signals then if outputs are needed; NaN before."""

    t: Float[Array, " events"]
    place: tuple[Any, ...]


class Fault(NamedTuple):
    """What goes wrong in each step: what (0: nothing), with which event, and about when, s."""

    kind: Int[Array, " steps"]
    event: Int[Array, " steps"]
    t: Float[Array, " steps"]


class Course(NamedTuple):
    """The integration of all steps of a grid; `places`: where its instants are among their beginnings; `seen`: when
    events are first met, s, NaN where they are not.
    """

    record: Record
    places: Int[Any, " instants"]
    seen: dict[str, Array]
    fault: Fault


class _Looked(NamedTuple):
    """The events that a step of the grid looks for.

    - `directions`: of each; `ends`: the one at which all ends, if any; `at`: where the step begins, as a fraction of
      the duration;
    - `ignored`: those that do not count in this step; `forced`: those at which it has to end.
    """

    directions: Int[np.ndarray, " events"]
    ends: Bool[np.ndarray, " events"]
    at: Float[Array, ""]
    ignored: Bool[Any, " events"]
    forced: Bool[Any, " events"]


class _Functions(NamedTuple):
    """What is said at a share of a step of the grid, and a vector there: the rates by this share, the functions of the
    events, and the vectors after each of these; what is noted of an event.
    """

    rates: Callable[[Any, Vector], Vector]
    levels: Callable[[Any, Vector], Float[Array, " events"]]
    after: Callable[[Any, Vector], Float[Array, "events n"]]
    noted: Callable[[Any, Vector], Seen]


class _State(NamedTuple):
    """How far the integration of one step of the grid is.

    - `vector`: all that is integrated, at the share `begin` of the step; `target`: the share to integrate to;
    - `low`, `high`: the shares between which the first event is;
    - `phase`: 0 on the way to the end of the step, then the number of the step of the search for `event`, negative
      where it is finished;
    - `speed`: the magnitude of the rate of the last event in this step; `left`: how many more there may be.
    """

    vector: Vector
    begin: Float[Array, ""]
    target: Float[Array, ""]
    low: Float[Array, ""]
    high: Float[Array, ""]
    phase: Int[Array, ""]
    event: Bool[Array, " events"]
    speed: Float[Array, ""]
    left: Int[Array, ""]
    seen: Seen


def course(
    tableau: Tableau,
    system: System,
    grid: Grid,
    inputs: Inputs,
    asked: Asked,
    names: tuple[str, ...],
    is_final: Bool[Array, ""] | None = None,
) -> Course:
    """The record of all steps, which end at the events `names` too; NaN from a fault on.

    - `is_final`: of a grid that ends by one of these, whether that is at the end of its last step; else it may be
      anywhere.
    """
    steps, places = steps_of(grid, inputs, [])
    t, now = steps.t[0], {name: values[places[0]] for name, values in steps.first.items()}
    start = initial_state(system, t, now)
    vector, named = ravel_pytree(((*start,), zeros(jax.eval_shape(lambda: asked.rates(system, t, start, now)))))
    size = sum(map(jnp.size, start))
    every = list(system.declared_events)
    directions = np.array([system.declared_events[name].direction for name in names])
    ends = np.array([name == grid.until for name in names])

    def states_of(vector: Vector) -> Any:
        return state_type(system.states)(*named(vector)[0])

    def looked_for(rows: Array) -> Array:
        return rows if names == tuple(every) else rows[np.array([every.index(name) for name in names])]

    def advance(carried: tuple[Vector, Seen], step: Steps) -> tuple[Any, tuple[dict[str, Array], Fault]]:
        vector, seen = carried
        signals = signals_within(grid, inputs, step)

        def rates(share: Any, vector: Vector) -> Vector:
            """By the share of the step."""
            t, u = as_time(step.t + share * step.h), signals(share)
            z = completed(system, t, states_of(vector), u)
            return step.h * ravel_pytree(asked.slopes(system, t, z, u))[0]

        def levels(share: Any, vector: Vector) -> Float[Array, " events"]:
            return looked_for(event_levels(system, step.t + share * step.h, states_of(vector), signals(share)))

        def after(share: Any, vector: Vector) -> Float[Array, "events n"]:
            states = looked_for(after_events(system, step.t + share * step.h, states_of(vector), signals(share)))
            if size == vector.size:
                return states
            return jnp.concatenate([states, jnp.broadcast_to(vector[size:], (len(names), vector.size - size))], axis=1)

        def noted(share: Any, vector: Vector) -> Seen:
            return Seen(step.t + share * step.h, (vector[:size], signals(share)) if asked.at_events else ())

        outputs = asked.at_instant(system, step.t, states_of(vector), step.first)
        ignored, forced, phase = np.zeros_like(ends), np.zeros_like(ends), none
        if is_final is not None:
            is_last = (step.begin < 1) & (step.begin + step.length >= 1)
            ignored, forced = is_final & ends, (is_final & is_last) & ends
            phase = _where(~is_final & ~jnp.isnan(seen.t[ends.argmax()]), _FINISHED, none)
        looked = _Looked(directions, ends, step.begin, ignored, forced)
        begin = _State(vector, zero, zero + 1, zero, zero + 1, phase, (zero > 0) & ends, zero, none + _MOST, seen)
        end = loop_while_any(
            lambda state: state.phase >= 0,
            lambda state: _moved(tableau, _Functions(rates, levels, after, noted), looked, state),
            begin,
        )
        fault = Fault(_FINISHED - end.phase, jnp.argmax(end.event), step.t + end.begin * step.h)
        return (end.vector, end.seen), (outputs, fault)

    zero, none = nothing(vector)
    places_seen = jax.eval_shape(lambda: (vector[:size], now) if asked.at_events else ())
    place = jax.tree.map(lambda one: zero + np.full((len(names), *one.shape), np.nan), places_seen)
    begin = vector, Seen(zero + np.full(len(names), np.nan), place)
    (end, seen), (history, fault) = jax.lax.scan(advance, begin, steps)

    def outputs(t: Array, states: Vector, now: dict[str, Array]) -> dict[str, Array]:
        return observation(system, t, variables_of(system, named(jnp.concatenate([states, end[size:]]))[0]), now)

    values = jax.vmap(outputs)(seen.t, *seen.place) if asked.at_events else {}
    times = {name: seen.t[i] for i, name in enumerate(names) if name in asked.events or name == grid.until}
    events = {
        name: Occurrence(t, {one: rows[names.index(name)] for one, rows in values.items()})
        for name, t in times.items()
        if name != grid.until
    }
    record, t_final = Record(history, {}, named(end)[1], events=events), times.get(grid.until or "", grid.t_final)
    if times:
        is_known = ~jnp.isnan(jnp.stack([*times.values()])).any()
        record = jax.tree.map(lambda one: _where(is_known, one, jnp.nan), record)
    return Course(record._replace(grid=grid.ending(t_final)), places, times, fault)


def _moved(tableau: Tableau, functions: _Functions, looked: _Looked, state: _State) -> _State:
    """One step of the method further: to the end of the step of the grid, or to where an event should be."""
    begin, target, directions = state.begin, state.target, looked.directions
    end, (level, rate), (level_at, rate_at) = _run(tableau, functions, begin, target - begin, state.vector)
    corrections = level_at / rate_at
    is_whole, lands = state.phase == 0, state.phase == _SEARCHED + _CORRECTIONS
    seeks = (state.phase >= 0) & (state.phase <= _SEARCHED)

    # The first event, and where it should be.
    levels, rates, corrected, reached = stop_gradient((level_at, rate_at, target - corrections, target))
    crosses = crosses_zero(level, rate, levels, rates, directions) & ~looked.ignored | looked.forced
    meets = crosses.any()
    low, high = _where(meets, state.low, reached), _where(meets, reached, state.high)
    middle, fits = (low + high) / 2, (corrected > low) & (corrected < high) | looked.forced
    place = jnp.argmin(_where(crosses, _where(fits, corrected, middle), jnp.inf))
    event = _where(meets & seeks, np.arange(directions.size) == place, state.event)
    correction = _where(event, corrections, 0.0).sum()
    is_close = jnp.abs(correction) <= CLOSE
    onward = _where(is_close | (fits & event).any(), target - correction, middle)

    # Before the step: at an event from the start, or still at the last one. After it: not at the event, or at another.
    stood = is_near(level, rate) & (directions * rate > 0)
    stays = (jnp.abs(level) <= CLOSE * state.speed) & ~(jnp.abs(rate) > _LEAST * state.speed)
    heads = is_near(levels, rates) & ((directions == 0) | (directions * rates > 0))
    faults = {
        TOGETHER: lands & (heads & ~event).any(),
        LOST: (state.phase >= _SEARCHED) & ~is_close,
        MANY: is_whole & meets & (state.left == 0),
        STAYS: is_whole & (begin < 1) & (state.speed > 0) & (stays & state.event).any(),
        AT_START: is_whole & (looked.at + begin == 0) & stood.any(),
    }
    fault = jnp.zeros_like(state.phase)
    for number, is_so in faults.items():
        fault = _where(is_so, number, fault)
    is_wrong, stops = fault > 0, lands & (event & looked.ends).any()
    arrives = (is_whole & ~meets) | stops
    phase = _where(lands, 0, _where(is_close & seeks, _SEARCHED, state.phase) + 1)
    after = _where(jnp.broadcast_to(event[:, None], (event.size, end.size)), functions.after(target, end), 0.0)
    return _State(
        vector=_where(is_wrong, jnp.nan, _where(arrives, end, _where(lands, after.sum(axis=0), state.vector))),
        begin=_where(lands, target, begin),
        target=_where(lands, 1.0, onward),
        low=_where(lands, reached, low),
        high=_where(lands, 1.0, high),
        phase=_where(state.phase < 0, state.phase, _where(arrives | is_wrong, _FINISHED - fault, phase)),
        event=_where(fault >= STAYS, _where(fault == STAYS, state.event, stood), event),
        speed=_where(lands, jnp.abs(_where(event, rates, 0.0).sum()), state.speed),
        left=state.left - lands,
        seen=_noted(state.seen, lands & event & jnp.isnan(state.seen.t), functions.noted(target, end)),
    )


def _noted(seen: Seen, is_new: Bool[Array, " events"], now: Seen) -> Seen:
    """The first of each event, with those of now that are."""

    def joined(old: Array, one: Array) -> Array:
        return _where(jax.lax.broadcast_in_dim(is_new, old.shape, (0,)), jnp.broadcast_to(one, old.shape), old)

    return jax.tree.map(joined, seen, now)


def _where(is_first: Array, first: Any, second: Any) -> Array:
    """`jnp.where` for values of one shape and numbers: by fewer equations, of which a step has many."""
    shape, dtype = jnp.broadcast_shapes(jnp.shape(first), jnp.shape(second)), jnp.result_type(first, second)
    sides = (jnp.broadcast_to(jnp.asarray(one, dtype), shape) for one in (first, second))
    return jax.lax.select(is_first, *sides)


def crosses_zero(level: Array, rate: Array, level_at: Array, rate_at: Array, directions: Any) -> Bool[Array, " n"]:
    """Whether levels end on the other side of zero, in a direction that counts.

    - `rate`: in a step. The side is that of a moment later: so a start on the ground is no landing.
    """
    is_above, ends_above = level + CLOSE * rate >= 0, level_at + CLOSE * rate_at >= 0
    counts = ends_above & np.asarray(directions >= 0) | is_above & np.asarray(directions <= 0)
    return (is_above != ends_above) & counts & jnp.isfinite(level_at)


def is_near(level: Array, rate: Array) -> Array:
    """Whether levels are zero up to rounding."""
    return jnp.abs(level) <= CLOSE * jnp.abs(rate)


def crossing_of(level: Array, rise: Array, level_at: Array, rise_at: Array) -> Array:
    """Where levels that end on the other side of zero in an interval cross it, as a part of it: without derivatives.

    By cubic Hermite interpolation, which is as accurate as a step of fourth order. `rise`: the rates by this part.
    """
    level, rise, level_at, rise_at = stop_gradient((level, rise, level_at, rise_at))

    def halved(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        c = (low + high) / 2
        d = 1 - c
        middle = d * d * ((1 + 2 * c) * level + c * rise) + c * c * ((1 + 2 * d) * level_at - d * rise_at)
        is_before = (middle >= 0) == (level + CLOSE * rise >= 0)
        return jnp.where(is_before, c, low), jnp.where(is_before, high, c)

    return jax.lax.fori_loop(0, _HALVED, halved, (jnp.zeros_like(level), jnp.ones_like(level)))[1]


def _run(
    tableau: Tableau, functions: _Functions, begin: Any, share: Any, vector: Vector
) -> tuple[Vector, tuple[Array, Array], tuple[Array, Array]]:
    """The end of one step of the method, and the functions of the events with their rates at its beginning and end."""
    # The last stage is at the end, so that rates are compiled once.
    couplings = jnp.asarray(square((*tableau.couplings, tableau.weights)))
    rows = jnp.asarray([*tableau.nodes, 1.0]), couplings, jnp.eye(len(couplings))

    def stage(stages: Array, row: tuple[Array, Array, Array]) -> tuple[Array, None]:
        node, coupling, unit = row
        slope = functions.rates(begin + node * share, vector + share * (coupling @ stages))
        return stages + jnp.outer(unit, slope), None

    def level_and_rate(at: Array, vector: Vector, slope: Vector) -> tuple[Array, Array]:
        return jax.jvp(functions.levels, (at, vector), (jnp.ones(()), slope))

    stages, _ = jax.lax.scan(stage, jnp.zeros((len(couplings), vector.size)), rows)
    end = vector + share * (couplings[-1] @ stages)
    both = jnp.stack([begin, begin + share]), jnp.stack([vector, end]), stages[:: len(stages) - 1]
    (level, level_at), (rate, rate_at) = jax.vmap(level_and_rate)(*both)
    return end, stop_gradient((level, rate)), (level_at, rate_at)


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
