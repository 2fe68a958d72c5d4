"""Grids whose end or start is sought in each realisation: an event ends them, or they repeat.

What is sought, the final time and the initial states of a cycle, solves equations at the last instant. Newton's method
passes over the grid again and again; the last passes correct what is sought by no more than rounding, and give its
derivatives, one order each.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from aleator.dynamics._crossings import CLOSE, crosses_zero, crossing_of, is_near, nothing
from aleator.dynamics._equations import TracedSystem
from aleator.dynamics._evaluation import after_events, derivative, event_levels, initial_state
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._record import STATES, Asked, Record, zeros
from aleator.dynamics._system import System

# Passes that correct by rounding alone, the last of which is the record; and passes in all.
_LAST, _MOST = 4, 60
# The shortest period, as a part of the time until the latest end. An event before that is the one at the start.
_SHORTEST = 0.05
# The shortest part of a correction that is tried.
_LEAST = 2.0**-8

Vector = Float[Array, " n"]
Recorded = Callable[[System, Grid, Inputs, Asked], Record]


class _Pass(NamedTuple):
    """How far the iteration is.

    - `sought`: the initial states of a cycle, then the final time of a grid that ends by an event; `base`, `correction`:
      where the latest correction was made, and all of it; `length`: of it, relative to the sizes of what is sought;
    - `damping`: the part of it that is tried; `last`: how many passes corrected by rounding alone;
    - `taken`: the record of the latest pass.
    """

    sought: Vector
    base: Vector
    correction: Vector
    length: Float[Array, ""]
    damping: Float[Array, ""]
    last: Int[Array, ""]
    count: Int[Array, ""]
    goes_on: Bool[Array, ""]
    taken: Record


class _Closure(NamedTuple):
    """What a pass over a grid says: the equations, their derivatives by what is sought, and what is recorded.

    - `sizes`: of what is sought; `end`: about when the event happens, NaN if it does not.
    """

    left: Vector
    slopes: Float[Array, "n n"]
    sizes: Vector
    end: Float[Array, ""]
    taken: Record


def closed(record: Recorded, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
    """The record of a realisation that ends at the event `until`, or repeats, with its grid; NaN where it does not.

    - `record`: that of an integrator; `inputs`: known on the whole grid, the system's own signals among them.

    A first pass on the whole grid tells about when the event happens, without derivatives. All passes are one loop,
    whose body is compiled once.
    """
    first, _ = ravel_pytree(initial_state(system, grid.t_start, inputs_on(grid, inputs)(grid.t_start)))
    zero, none = nothing(first)
    begun = jnp.concatenate(([first] if grid.periodic else []) + ([zero[None] + grid.t_final] if grid.until else []))
    over = _periodic if grid.periodic else _ending

    def passed(state: _Pass) -> _Pass:
        one = over(record, system, grid, inputs, asked._replace(states=True), state.sought)
        slopes = one.slopes if asked.multipliers else stop_gradient(one.slopes)
        correction = -jnp.linalg.solve(slopes, one.left) if grid.periodic else -one.left / slopes[0]
        length = stop_gradient(jnp.max(jnp.abs(correction) / jnp.where(one.sizes > 0, one.sizes, 1.0)))
        seeks = (state.count == 0) & (grid.until is not None)
        is_better = (length <= state.length) | (length <= CLOSE)
        base = jnp.where(is_better, state.sought, state.base)
        correction = jnp.where(is_better, correction, state.correction)
        damping = jnp.where(is_better, jnp.minimum(2 * state.damping, 1.0), state.damping / 4)
        sought = jnp.where(seeks, state.sought.at[-1].set(stop_gradient(one.end)), base + damping * correction)
        last = state.last + (~seeks & is_better & (length <= CLOSE))
        on = (last < _LAST) & (damping >= _LEAST) & (state.count < _MOST) & jnp.isfinite(sought).all()
        return _Pass(
            # The last pass is at what it was told.
            sought=jnp.where(last < _LAST, sought, state.sought),
            base=base,
            correction=correction,
            length=jnp.where(seeks, jnp.inf, jnp.where(is_better, length, state.length)),
            damping=jnp.where(seeks, 1.0, damping),
            last=last,
            count=state.count + 1,
            goes_on=on,
            taken=one.taken,
        )

    shapes = jax.eval_shape(lambda: over(record, system, grid, inputs, asked._replace(states=True), begun).taken)
    taken = jax.tree.map(lambda one: zero + one, zeros(shapes))
    start = _Pass(begun, begun, 0 * begun, zero + jnp.inf, zero + 1, none, none, none == 0, taken)
    end = jax.lax.while_loop(lambda state: state.goes_on, passed, start)
    t_final = end.sought[-1] if grid.until else zero + grid.t_final
    is_closed = end.last == _LAST
    if grid.periodic:
        # No time closes too.
        is_closed &= t_final - grid.t_start > _SHORTEST * grid.duration
    t_final, taken = jax.tree.map(lambda one: jnp.where(is_closed, one, jnp.nan), (t_final, end.taken))
    history = {name: values for name, values in taken.history.items() if asked.states or name != STATES}
    return taken._replace(history=history, grid=grid.ending(t_final) if grid.until else grid)


def _ending(
    record: Recorded, system: System, grid: Grid, inputs: Inputs, asked: Asked, sought: Float[Array, " 1"]
) -> _Closure:
    """A pass of a grid that ends by an event: the rate of its function is that along the states."""
    one = grid.ending(sought[0])
    taken = record(system, one, inputs, asked)
    levels, rates, end = _levels_along(system, one, inputs, taken.history[STATES])
    return _Closure(levels[-1:], rates[-1:, None], one.duration[None], end, taken)


def _periodic(
    record: Recorded, system: System, grid: Grid, inputs: Inputs, asked: Asked, sought: Vector
) -> _Closure:
    """A pass of a grid that repeats: the states at its end, after the event there, are those at its start."""
    assert isinstance(system, TracedSystem)
    count = sought.size - (grid.until is not None)

    def closure(sought: Vector) -> tuple[Vector, tuple[Vector, Vector, Array, Record]]:
        one = grid if grid.until is None else grid.ending(sought[-1])
        taken = record(system.beginning(sought[:count]), one, inputs, asked)
        rows, left, sizes, end = taken.history[STATES], [], [], jnp.asarray(one.t_final)
        arrived = rows[-1]
        if grid.until is not None:
            levels, _, end = _levels_along(system, one, inputs, rows)
            where = list(system.declared_events).index(grid.until)
            t, z = one.t_final, ravel_pytree(initial_state(system, one.t_start, inputs_on(one, inputs)(one.t_start)))[1](arrived)
            arrived = after_events(system, t, z, inputs_on(one, inputs)(t))[where]
            left, sizes = [levels[-1:]], [one.duration[None]]
        equations = jnp.concatenate([arrived - sought[:count], *left])
        return equations, (equations, jnp.concatenate([jnp.max(jnp.abs(rows), axis=0), *sizes]), end, taken)

    slopes, (left, sizes, end, taken) = jax.jacfwd(closure, has_aux=True)(sought)
    if asked.multipliers:
        step = slopes[:count, :count] + jnp.eye(count)
        if grid.until is not None:
            # The event's time moves with the initial states.
            step = step - jnp.outer(slopes[:count, -1], slopes[-1, :count]) / slopes[-1, -1]
        taken = taken._replace(monodromy=step)
    return _Closure(left, slopes, sizes, end, taken)


def _levels_along(
    system: System, grid: Grid, inputs: Inputs, rows: Float[Array, "instants states"]
) -> tuple[Float[Array, " instants"], Float[Array, " instants"], Float[Array, ""]]:
    """The function of the event that ends a grid at its instants, its rate along the states, and about when the event
    happens; NaN if it does not.
    """
    assert grid.until is not None
    where, direction = list(system.declared_events).index(grid.until), system.declared_events[grid.until].direction
    now = inputs_on(grid, inputs)
    named = ravel_pytree(initial_state(system, grid.t_start, now(grid.t_start)))[1]

    def level_and_rate(t: Array, row: Vector) -> tuple[Array, Array]:
        z, u = named(row), now(t)
        slopes = jnp.ones(()), derivative(system, t, z, u)
        return jax.jvp(lambda t, z: event_levels(system, t, z, now(t))[where], (t, z), slopes)

    level, rate = jax.vmap(level_and_rate)(grid.times, rows)
    known = stop_gradient((level[:-1], rate[:-1] * grid.step, level[1:], rate[1:] * grid.step))
    side, crosses = crosses_zero(*known, direction)
    stood = is_near(known[0][0], known[1][0]) & (direction * rate[0] > 0)
    if grid.periodic:
        # A cycle starts where the one before ended, up to the error of the guess.
        crosses, stood = crosses & (grid.fractions[1:] > _SHORTEST), False
    k = jnp.argmax(crosses)
    end = grid.times[k] + crossing_of(side, *known)[k] * grid.step
    return level, rate, jnp.where(crosses.any() & ~stood, end, jnp.nan)
