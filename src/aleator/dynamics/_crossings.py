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

from aleator._core.equations import as_time
from aleator._core.loops import loop_while_any
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
LOST, MANY, AT_START, TOGETHER, STAYS = range(1, 6)
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

    - `directions`: of each; `begins`: whether the step is the first; `noted`: which of them are, by place; `ends`: the one at which all ends, if any;
    - `ignored`: those that do not count in this step; `forced`: those at which it has to end.
    """

    directions: Int[Array, " events"]
    begins: Bool[Array, ""] | None
    noted: Int[np.ndarray, " noted"]
    ends: Bool[np.ndarray, " events"]
    ignored: Bool[Array, " events"] | None = None
    forced: Bool[Array, " events"] | None = None


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
    - `phase`: 0 on the way to the end of the step, then the number of the step of the search for `event`;
    - `speed`: the magnitude of the rate of the last event in this step; `left`: how many more there may be;
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
    which = np.array([every.index(name) for name in names])
    wanted = [name for name in names if name in asked.events or name == grid.until]
    looked = _Looked(
        directions=jnp.asarray([system.declared_events[name].direction for name in names]),
        begins=None,
        noted=np.array([names.index(name) for name in wanted], dtype=int),
        ends=np.array([name == grid.until for name in names]),
    )

    def states_of(vector: Vector) -> Any:
        return state_type(system.states)(*named(vector)[0])

    def advance(carried: tuple[Vector, Seen], step: Steps) -> tuple[Any, tuple[dict[str, Array], Fault]]:
        vector, seen = carried
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
            return jnp.concatenate([states, jnp.broadcast_to(vector[size:], (len(names), vector.size - size))], axis=1)

        def noted(share: Any, vector: Vector) -> Seen:
            return Seen(step.t + share * step.h, (vector[:size], signals(share)) if asked.at_events else ())

        outputs = asked.at_instant(system, step.t, states_of(vector), step.first)
        zero, none = nothing(vector)
        own, phase = looked._replace(begins=step.begin == 0), none
        if is_final is not None:
            is_last = (step.begin < 1) & (step.begin + step.length >= 1)
            own = own._replace(ignored=looked.ends & is_final, forced=looked.ends & (is_final & is_last))
            is_over = ~is_final & ~jnp.isnan(seen.t[wanted.index(grid.until or "")])
            phase = jnp.where(is_over, _FINISHED, none)
        begin = _State(
            vector, zero, zero + 1, zero, zero + 1, phase, looked.ends & (none != 0), zero, none + _MOST, seen
        )
        end = loop_while_any(
            lambda state: state.phase >= 0,
            lambda state: _moved(tableau, _Functions(rates, levels, after, noted), own, state),
            begin,
        )
        fault = Fault(_FINISHED - end.phase, jnp.argmax(end.event), step.t + end.begin * step.h)
        return (end.vector, end.seen), (outputs, fault)

    zero, _ = nothing(vector)
    shapes = jax.eval_shape(lambda: (vector[:size], now) if asked.at_events else ())
    place = jax.tree.map(lambda one: zero + jnp.full((len(wanted), *one.shape), jnp.nan), shapes)
    begin = vector, Seen(zero + jnp.full(len(wanted), jnp.nan), place)
    (end, seen), (history, fault) = jax.lax.scan(advance, begin, steps)

    def outputs(t: Array, states: Vector, now: dict[str, Array]) -> dict[str, Array]:
        return observation(system, t, variables_of(system, named(jnp.concatenate([states, end[size:]]))[0]), now)

    values = jax.vmap(outputs)(seen.t, *seen.place) if asked.at_events else {}
    times = {name: seen.t[i] for i, name in enumerate(wanted)}
    events = {
        name: Occurrence(t, {output: one[wanted.index(name)] for output, one in values.items()})
        for name, t in times.items()
        if name != grid.until
    }
    is_known = ~jnp.isnan(seen.t).any()
    record = Record(history, {}, named(end)[1], events=events)
    record = jax.tree.map(lambda one: jnp.where(is_known, one, jnp.nan), record)
    return Course(record._replace(grid=grid.ending(times.get(grid.until, grid.t_final))), places, times, fault)


def _moved(tableau: Tableau, functions: _Functions, looked: _Looked, state: _State) -> _State:
    """One step of the method further: to the end of the step of the grid, or to where an event should be."""
    vector, begin, target, directions = state.vector, state.begin, state.target, looked.directions
    end, *slopes = _run(tableau, functions.rates, begin, target - begin, vector)

    def level_and_rate(share: Array, vector: Vector, slope: Vector) -> tuple[Array, Array]:
        return jax.jvp(functions.levels, (share, vector), (jnp.ones(()), slope))

    ends = jnp.stack([begin, target]), jnp.stack([vector, end]), jnp.stack(slopes)
    (level, level_at), (rate, rate_at) = jax.vmap(level_and_rate)(*ends)
    corrections = level_at / rate_at

    # The first event, and where it should be.
    known = stop_gradient((level, rate, level_at, rate_at, corrections, target))
    crosses, corrected = crosses_zero(*known[:4], directions)[1], known[5] - known[4]
    if looked.ignored is not None:
        crosses = crosses & ~looked.ignored | looked.forced
    meets = crosses.any()
    low, high = jnp.where(meets, state.low, known[5]), jnp.where(meets, known[5], state.high)
    middle, fits = (low + high) / 2, (corrected > low) & (corrected < high)
    if looked.forced is not None:
        fits = fits | looked.forced
    places = jnp.where(crosses, jnp.where(fits, corrected, middle), jnp.inf)
    seeks = (state.phase >= 0) & (state.phase <= _SEARCHED)
    event = jnp.where(meets & seeks, jnp.arange(directions.size) == jnp.argmin(places), state.event)
    correction = jnp.where(event, corrections, 0.0).sum()
    is_close = jnp.abs(correction) <= CLOSE
    onward = jnp.where(is_close | (fits & event).any(), target - correction, middle)

    is_whole, lands = state.phase == 0, state.phase == _SEARCHED + _CORRECTIONS
    # Before the step: at an event from the start, or still at the last one. After it: not at the event, or at another.
    stood = is_near(level, rate) & (directions * rate > 0)
    stays = (jnp.abs(level) <= CLOSE * state.speed) & ~(jnp.abs(rate) > _LEAST * state.speed)
    heads = is_near(level_at, rate_at) & ((directions == 0) | (directions * rate_at > 0))
    kind = jnp.select(
        [
            is_whole & (looked.begins & (begin == 0)) & stood.any(),
            is_whole & (begin < 1) & (state.speed > 0) & (stays & state.event).any(),
            is_whole & meets & (state.left == 0),
            (state.phase >= _SEARCHED) & ~is_close,
            lands & (heads & ~event).any(),
        ],
        [AT_START, STAYS, MANY, LOST, TOGETHER],
        0,
    )
    which = jnp.where(kind == AT_START, stood, jnp.where(kind == STAYS, state.event, event))
    stops = lands & (event & looked.ends).any()
    arrives = (is_whole & ~meets) | stops
    after = jnp.where(event[:, None], functions.after(target, end), 0.0).sum(axis=0)
    vector = jnp.where(arrives, end, jnp.where(lands, after, vector))

    new, now = lands & event[looked.noted] & jnp.isnan(state.seen.t), functions.noted(target, end)
    seen = jax.tree.map(lambda old, one: jnp.where(new.reshape(-1, *[1] * (old.ndim - 1)), one, old), state.seen, now)
    phase = jnp.where(lands, 0, jnp.where(is_close & seeks, _SEARCHED, state.phase) + 1)
    phase = jnp.where(arrives | (kind > 0), _FINISHED - kind, phase)
    return _State(
        vector=jnp.where(kind > 0, jnp.nan, vector),
        begin=jnp.where(lands, target, begin),
        target=jnp.where(lands, 1.0, onward),
        low=jnp.where(lands, known[5], low),
        high=jnp.where(lands, 1.0, high),
        phase=jnp.where(state.phase < 0, state.phase, phase),
        event=which,
        speed=jnp.where(lands, jnp.abs(jnp.where(event, rate_at, 0.0).sum()), state.speed),
        left=state.left - lands,
        seen=seen,
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
