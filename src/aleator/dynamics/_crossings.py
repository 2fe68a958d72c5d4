"""Events of a realisation: steps that end where a function crosses zero.

A step that meets an event is divided: up to the event, the jump, and the rest, which may meet others. Newton's method
finds the event, by the function over its rate at the end of a shorter and shorter step; where it would leave the
interval that is known to hold the first event, this is halved. Each correction multiplies errors of the time and of its
derivatives of any order by the order of the error of the step: what the crossing does to derivatives of later states
(saltation) comes out by itself.

Steps are those of the grid, or of an adaptive method, which are looked at once their error is small enough.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from aleator._core.equations import as_time, loop_while_any
from aleator.dynamics._alike import together
from aleator.dynamics._equations import TracedSystem, moving
from aleator.dynamics._evaluation import (
    after_events,
    algebraic_residuals,
    completed,
    event_levels,
    guessed_algebraic,
    initial_state,
    observation,
    variables_of,
)
from aleator.dynamics._event import CLOSE, Fault, crosses_zero, leads_across, level_and_rate
from aleator.dynamics._grid import Grid, Inputs
from aleator.dynamics._record import Asked, Occurrence, Record, nothing, zeros
from aleator.dynamics._steps import Method, Pace, Rates, Sizes, Steps, Vector, signals_within, steps_of
from aleator.dynamics._system import System, state_type

# Steps of the search for an event at most, and corrections of its time afterwards, for derivatives.
_SEARCHED, _CORRECTIONS = 24, 4
# A jump that leaves a smaller part of the rate of an event leaves it where it is.
_LEAST = 1e-6
# The most events in one step of the grid; the shortest step of an adaptive method, relative to the time.
_MOST, _SHORTEST = 12, 4 * float(np.finfo(float).eps)
# What may go wrong.
LOST, MANY, TOGETHER, NO_NUMBER, STAYS, AT_START, GIVEN_UP = range(1, 8)
# The phase of a step of the grid that is finished; less the number of what went wrong.
_FINISHED = -1


class Seen(NamedTuple):
    """The first of each event that is noted: when, s, and states and signals then if outputs are needed; NaN before."""

    t: Float[Array, " events"]
    place: tuple[Any, ...]


class Course(NamedTuple):
    """The integration of all steps of a grid.

    - `places`: where its instants are among their beginnings; `seen`: when events are first met, s, NaN where they are
      not; `end`, `pace`: how far it came.
    """

    record: Record
    places: Int[Any, " instants"]
    seen: dict[str, Array]
    fault: Fault
    end: Vector
    pace: Pace | None


class _Looked(NamedTuple):
    """The events that a step of the grid looks for.

    - `directions`: of each; `ends`: the one at which all ends, if any; `at`: where the step begins, as a fraction of
      the duration;
    - `ignored`: those that do not count in this step; `forced`: those at which it has to end; `departed`: those at
      which the motion may start, whatever comes next.
    """

    directions: Int[np.ndarray, " events"]
    ends: Bool[np.ndarray, " events"]
    at: Float[Array, ""]
    ignored: Bool[Any, " events"]
    forced: Bool[Any, " events"]
    departed: Bool[np.ndarray, " events"]


class _Functions(NamedTuple):
    """What is said at a share of a step of the grid, and a vector there: the rates, the functions of the events, and
    the vector after one of these; what is noted of an event.
    """

    rates: Rates
    levels: Callable[[Any, Vector], Float[Array, " events"]]
    after: Callable[[Any, Vector, Bool[Array, " events"]], Vector]
    noted: Callable[[Any, Vector], Seen]


class _Search(NamedTuple):
    """The search for events in a step of the grid.

    - `target`: the share to integrate to; `low`, `high`: the shares between which the first event is; `event`: which;
    - `speed`: the magnitude of the rate of the event at which this begins, 0 without one; `left`: how many more there
      may be.
    """

    target: Float[Array, ""]
    low: Float[Array, ""]
    high: Float[Array, ""]
    event: Bool[Array, " events"]
    speed: Float[Array, ""]
    left: Int[Array, ""]
    seen: Seen


class _State(NamedTuple):
    """How far the integration of one step of the grid is.

    - `vector`: all that is integrated, at the share `begin` of the step;
    - `phase`: 0 on the way to the end of the step, then the number of the step of the search for an event, negative
      where it is finished;
    - `search`: None without events; `pace`: of an adaptive method.
    """

    vector: Vector
    begin: Float[Array, ""]
    phase: Int[Array, ""]
    search: _Search | None
    pace: Pace | None


def course(
    method: Method,
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
    count = len(system.states)
    # Other methods find algebraic variables wherever they see states.
    carries = bool(system.algebraic) and method.carries_algebraic
    once = partial(together, count + len(system.algebraic))
    layouts: list[tuple[Callable[[Vector], Any], Sizes]] = []

    def begun() -> Vector:
        start = initial_state(system, t, now)
        guess = guessed_algebraic(system, t, start, now) if carries else ()
        integrands = zeros(jax.eval_shape(lambda: asked.rates(system, t, start, now)))
        vector, named = ravel_pytree(((*start, *guess), integrands))
        size, algebraic = (sum(map(jnp.size, part)) for part in (start, guess))
        layouts.append((named, Sizes(size, algebraic, vector.size - size - algebraic)))
        return vector

    vector, ((named, sizes),) = once(begun), layouts
    size = sizes.states
    every = list(system.declared_events)
    directions = np.array([system.declared_events[name].direction for name in names])
    ends = np.array([name == grid.until for name in names], dtype=bool)
    # A phase may start at the event, in any direction, that ended the one before.
    departed = (directions == 0) & (isinstance(system, TracedSystem) and system.begun is not None)

    def states_of(vector: Vector) -> Any:
        return state_type(system.states)(*named(vector)[0][:count])

    def looked_for(rows: Array) -> Array:
        return rows if names == tuple(every) else rows[np.array([every.index(name) for name in names])]

    def solved(t: Any, states: Any, vector: Vector, u: dict[str, Array]) -> Any:
        """States with algebraic variables that the method carries, near those of a vector."""
        if not carries:
            return states
        return completed(system, t, states, u, state_type(system.algebraic)(*named(vector)[0][count:]))

    def advance(carried: tuple[Vector, Seen, Any], step: Steps) -> tuple[Any, tuple[dict[str, Array], Fault]]:
        vector, seen, pace = carried
        signals = signals_within(grid, inputs, step)
        # Equations without rates are not multiplied by the length of the step, so that they hold over no time too.
        lengths = step.h * sizes.has_rate + (1.0 - sizes.has_rate) if carries else step.h

        def rates(share: Any, vector: Vector) -> Vector:
            t, u = as_time(step.t + share * step.h), signals(share)
            z = completed(system, t, variables_of(system, named(vector)[0]), u)
            slopes, growths = asked.slopes(system, t, z, u)
            residuals = algebraic_residuals(system, t, z, u) if carries else ()
            return lengths * ravel_pytree((slopes, residuals, growths))[0]

        def levels(share: Any, vector: Vector) -> Float[Array, " events"]:
            return looked_for(event_levels(system, step.t + share * step.h, states_of(vector), signals(share)))

        def after(share: Any, vector: Vector, event: Bool[Array, " events"]) -> Vector:
            t, u = step.t + share * step.h, signals(share)
            rows = looked_for(after_events(system, t, states_of(vector), u))
            states = _where(jnp.broadcast_to(event[:, None], rows.shape), rows, 0.0).sum(axis=0)
            if carries:
                later = vector.at[:size].set(_where(event.any(), states, vector[:size]))
                states = ravel_pytree(tuple(solved(t, states_of(later), vector, u)))[0]
            return states if states.size == vector.size else jnp.concatenate([states, vector[states.size :]])

        def noted(share: Any, vector: Vector) -> Seen:
            return Seen(step.t + share * step.h, (vector[:size], signals(share)) if asked.at_events else ())

        def at_instant(vector: Vector) -> dict[str, Array]:
            return asked.at_instant(system, step.t, variables_of(system, named(vector)[0]), step.first)

        if carries:  # Algebraic variables jump with the inputs: the step begins with those on its own side.
            z = solved(step.t, states_of(vector), vector, step.first)
            vector = ravel_pytree(((*z,), named(vector)[1]))[0]
        outputs = once(at_instant, vector)
        ignored, forced, phase = np.zeros_like(ends), np.zeros_like(ends), none
        if pace is not None:
            latest = jnp.maximum(jnp.abs(step.t), jnp.abs(step.t + step.h))
            pace = stop_gradient(pace._replace(length=step.h, shortest=_SHORTEST * latest))
            phase = _where(pace.goes_on, phase, _FINISHED - GIVEN_UP)
        if is_final is not None:
            is_last = (step.begin < 1) & (step.begin + step.length >= 1)
            ignored, forced = is_final & ends, (is_final & is_last) & ends
            phase = _where(~is_final & ~jnp.isnan(seen.t[ends.argmax()]), _FINISHED, phase)
        looked = _Looked(directions, ends, step.begin, ignored, forced, departed)
        functions = _Functions(partial(once, rates), partial(once, levels), partial(once, after), noted)
        search = _Search(zero + 1, zero, zero + 1, (zero > 0) & ends, zero, none + _MOST, seen) if names else None
        # Without events JAX's own loop tells how the program has to be compiled (see `asks_twice`).
        loop = loop_while_any if names else jax.lax.while_loop
        end = loop(
            lambda state: state.phase >= 0,
            lambda state: _moved(method, functions, looked, sizes, state),
            _State(vector, zero, phase, search, pace),
        )
        event, met, number, vector, kind = none, none, none, end.vector, _FINISHED - end.phase
        if end.search is not None:
            event, met, seen = jnp.argmax(end.search.event), _MOST - end.search.left, end.search.seen
            number = jnp.argmin(jnp.isfinite(vector))
            vector = _where((kind > 0) & (kind < GIVEN_UP), jnp.nan, vector)
        fault = Fault(kind, event, step.t + end.begin * step.h, met, number)
        return (vector, seen, end.pace), (outputs, fault)

    zero, none = nothing(moving(system), inputs, grid)
    places_seen = jax.eval_shape(lambda: (vector[:size], now) if asked.at_events else ())
    place = jax.tree.map(lambda one: zero + np.full((len(names), *one.shape), np.nan), places_seen)
    pace = jax.tree.map(lambda one: one + stop_gradient(zero).astype(one.dtype), method.begun(grid))
    begin = zero + vector, Seen(zero + np.full(len(names), np.nan), place), pace
    (end, seen, pace), (history, fault) = jax.lax.scan(advance, begin, steps)

    def outputs(t: Array, states: Vector, now: dict[str, Array]) -> dict[str, Array]:
        return observation(system, t, states_of(jnp.concatenate([states, end[size:]])), now)

    values = jax.vmap(outputs)(seen.t, *seen.place) if asked.at_events and names else {}
    times = {name: seen.t[i] for i, name in enumerate(names) if name in asked.events or name == grid.until}
    events = {
        name: Occurrence(t, {one: rows[names.index(name)] for one, rows in values.items()})
        for name, t in times.items()
        if name != grid.until
    }
    integrals = once(lambda vector: named(vector)[1], end)
    record, t_final = Record(history, {}, integrals, events=events), times.get(grid.until or "", grid.t_final)
    if times:
        is_known = ~jnp.isnan(jnp.stack([*times.values()])).any()
        record = jax.tree.map(lambda one: _where(is_known, one, jnp.nan), record)
    if pace is not None:
        is_complete = (fault.kind != GIVEN_UP).all()
        record, t_final = jax.tree.map(lambda one: _where(is_complete, one, jnp.nan), (record, t_final))
    return Course(record._replace(grid=grid.ending(t_final)), places, times, fault, end, pace)


def _moved(method: Method, functions: _Functions, looked: _Looked, sizes: Sizes, state: _State) -> _State:
    """One step of the method further: to the end of the step of the grid, or to where an event should be; an adaptive
    method may try it again.
    """
    begin, search, pace, is_whole = state.begin, state.search, state.pace, state.phase == 0
    target = jnp.ones(()) if search is None else search.target
    if pace is not None:
        rest = 1 - begin
        parts = jnp.maximum(jnp.ceil(stop_gradient(rest) * pace.length / pace.h), 1.0)
        target = _where(is_whole & (parts > 1), begin + rest / parts, target)
    end, slopes, is_close, later = method.step(functions.rates, begin, target - begin, state.vector, sizes, pace)
    if search is not None:
        if slopes is None:
            slopes = jax.vmap(functions.rates)(jnp.stack([begin, target]), jnp.stack([state.vector, end]))
        moved = _met(functions, looked, state, sizes, target, end, slopes)
    else:
        moved = state._replace(vector=end, begin=target, phase=_where(target == 1, _FINISHED, state.phase))
    if pace is None or later is None:
        return moved
    # No time but rounding, between two jumps at once or after the end, passes whatever the rates, and tells nothing.
    tells = 2 * (target - begin) * pace.length > pace.shortest
    stays = is_whole & tells & ~jnp.asarray(is_close)
    later = later._replace(h=_where(tells, later.h, pace.h))
    if search is not None:
        stays |= state.phase < 0
        later = jax.tree.map(lambda old, new: old if new is old else _where(is_whole, new, old), pace, later)
    moved = jax.tree.map(lambda old, new: old if new is old else _where(stays, old, new), state, moved)
    is_given_up = (moved.phase == 0) & ~later.goes_on
    return moved._replace(pace=later, phase=_where(is_given_up, _FINISHED - GIVEN_UP, moved.phase))


def _met(
    functions: _Functions, looked: _Looked, state: _State, sizes: Sizes, target: Array, end: Vector, slopes: Array
) -> _State:
    """What follows a step to some share, by the events on the way; `slopes`: the rates at both ends."""
    search = state.search
    assert search is not None

    def at(share: Array, vector: Vector, slope: Vector) -> tuple[Array, Array]:
        return level_and_rate(functions.levels, (share, vector), (jnp.ones(()), slope))

    both = jnp.stack([state.begin, target]), jnp.stack([state.vector, end]), slopes
    (level, level_at), (rate, rate_at) = jax.vmap(at)(*both)
    level, rate = stop_gradient((level, rate))
    begin, directions, corrections = state.begin, looked.directions, level_at / rate_at
    is_whole, lands = state.phase == 0, state.phase == _SEARCHED + _CORRECTIONS
    seeks = (state.phase >= 0) & (state.phase <= _SEARCHED)
    # A shorter step of an adaptive method is not the last one.
    forced = looked.forced if state.pace is None else looked.forced & _where(is_whole, target == 1, search.event)

    # The first event, and where it should be.
    levels, rates, corrected, reached = stop_gradient((level_at, rate_at, target - corrections, target))
    crosses = crosses_zero(level, rate, levels, rates, directions) & ~looked.ignored | forced
    meets = crosses.any()
    low, high = _where(meets, search.low, reached), _where(meets, reached, search.high)
    middle, fits = (low + high) / 2, (corrected > low) & (corrected < high) | forced
    place = jnp.argmin(_where(crosses, _where(fits, corrected, middle), jnp.inf))
    event = _where(meets & seeks, np.arange(directions.size) == place, search.event)
    correction = _where(event, corrections, 0.0).sum()
    is_close = jnp.abs(correction) <= CLOSE
    onward = _where(is_close | (fits & event).any(), target - correction, middle)

    # Before the step: at an event from the start or at rest there, or still at the last one. After it: not at the
    # event, or at another. Next to no rate tells no direction, but where the step leads.
    onwards = _where(jnp.abs(rate) <= CLOSE * jnp.abs(levels), levels, rate)
    starts = (looked.at + begin == 0) & ~looked.departed | (level == 0) & (rate == 0)
    stood = leads_across(level, onwards, directions) & starts
    stays = (jnp.abs(level) <= CLOSE * search.speed) & ~(jnp.abs(rate) > _LEAST * search.speed)
    heads = leads_across(levels, rates, directions)
    stops, jumped = lands & (event & looked.ends).any(), functions.after(target, end, event)
    is_lost = ~jnp.isfinite(jumped[: sizes.states]) & jnp.isfinite(end[: sizes.states])
    faults = {
        TOGETHER: lands & (heads & ~event).any(),
        LOST: (state.phase >= _SEARCHED) & ~is_close,
        MANY: is_whole & meets & (search.left == 0),
        NO_NUMBER: lands & ~stops & is_lost.any(),
        AT_START: is_whole & stood.any(),
        STAYS: is_whole & (begin < 1) & (search.speed > 0) & (stays & search.event).any(),
    }
    fault = jnp.zeros_like(state.phase)
    for number, is_so in faults.items():
        fault = _where(is_so, number, fault)
    is_wrong = fault > 0
    passes = is_whole & ~meets & ~is_wrong
    arrives = passes & (target == 1) | stops
    goes = lands | passes
    after = _where(lands, jumped, _where(passes, end, state.vector))
    phase = _where(goes, 0, _where(is_close & seeks, _SEARCHED, state.phase) + 1)
    later = _Search(
        target=_where(goes, 1.0, onward),
        low=_where(goes, reached, low),
        high=_where(goes, 1.0, high),
        event=_where(fault >= STAYS, _where(fault == STAYS, search.event, stood), event),
        speed=_where(lands, jnp.abs(_where(event, rates, 0.0).sum()), _where(passes, 0.0, search.speed)),
        left=search.left - lands,
        seen=_noted(search.seen, lands & event & jnp.isnan(search.seen.t), functions.noted(target, end)),
    )
    return state._replace(
        vector=_where(stops, end, after),
        begin=_where(goes, target, begin),
        phase=_where(state.phase < 0, state.phase, _where(arrives | is_wrong, _FINISHED - fault, phase)),
        search=later,
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
