"""Grids that repeat: the start is sought in each realisation.

What is sought, the initial states of a cycle and its final time where an event ends it, solves equations at the last
instant. It is found without derivatives. Passes over the grid then correct it, and give its derivatives, one order
each; the last one is the record. All of these are one loop, whose body is compiled once.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from aleator.dynamics._equations import TracedSystem
from aleator.dynamics._evaluation import after_events, derivative, event_levels, initial_state
from aleator.dynamics._event import CLOSE, crosses_zero, level_and_rate
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._record import ONLY_STATES, STATES, Asked, Record, nothing, zeros
from aleator.dynamics._steps import Vector
from aleator.dynamics._system import System

# Passes that correct what is sought, those before the record.
_PASSES = 5
# Steps of Newton's method towards a cycle at most, and the shortest part of one that is tried.
_MOST, _LEAST = 60, 2.0**-8
# Halvings of a step in which an event is sought between instants.
_HALVED = 20
# The shortest period, as a part of a step until the latest end: no time closes too.
_SHORTEST = 0.05
# A first crossing is the one at the start, which lies just before it, if the event's function comes from so small a
# part of what it reaches before the next.
_AT_START = 0.05
# Rates that differ by this part of the largest one are the same.
_SAME = 1e-6
# Cycles that close up to this part of the states are of a family, if as small a part of what they start from matters:
# steps of an integrator close those of a conserved energy to their own accuracy. So many corrections find one.
_ALIKE, _CORRECTIONS = 1e-3, 8

Recorded = Callable[[System, Grid, Inputs, Asked], Record]


def closed(record: Recorded, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
    """The record of a realisation that repeats, with its grid; NaN where it does not.

    - `record`: that of an integrator; `inputs`: known on the whole grid, the system's own signals among them.
    """
    assert isinstance(system, TracedSystem)
    cycle = _Cycle(record, system, grid, inputs)
    start, inverse = cycle.begun()

    def passed(state: tuple[Vector, Any], step: None) -> tuple[tuple[Vector, Any], None]:
        del step
        left, sizes, _, taken = cycle.over(state[0], asked._replace(states=True))
        correction = inverse @ left
        length = stop_gradient(jnp.max(jnp.abs(correction) / jnp.where(sizes > 0, sizes, 1.0)))
        return (state[0] - correction, (state[0], length, taken)), None

    zero, _ = nothing(start)
    shapes = jax.eval_shape(lambda: cycle.over(start, asked._replace(states=True)).taken)
    taken = jax.tree.map(lambda one: zero + one, (start, zero, zeros(shapes)))
    (_, (sought, length, taken)), _ = jax.lax.scan(passed, (zero + start, taken), length=_PASSES + 1)
    states, end = (sought, grid.t_final) if grid.until is None else (sought[:-1], sought[-1])
    is_closed = (length <= CLOSE) & repeats(system, grid, inputs, states, end)
    sought, taken = jax.tree.map(lambda one: jnp.where(is_closed, one, jnp.nan), (sought, taken))
    if asked.multipliers:
        taken = taken._replace(monodromy=cycle.monodromy(sought))
    history = {name: values for name, values in taken.history.items() if asked.states or name != STATES}
    return taken._replace(history=history, grid=grid.ending(sought[-1]) if grid.until else grid)


def repeats(
    system: System, grid: Grid, inputs: Inputs, states: Vector | None = None, end: Any = None
) -> Bool[Array, ""]:
    """Whether rates after a cycle are those before it, of the same states and inputs: a time in the equations
    themselves may not come again.

    - `states`, `end`: by default those of the system and the grid.
    """
    t, now = jnp.asarray(grid.t_start, dtype=float), inputs_on(grid, inputs)(grid.t_start)
    own, named = ravel_pytree(initial_state(system, t, now))
    z, last = named(own if states is None else states), jnp.asarray(grid.t_final if end is None else end)
    before, after = (ravel_pytree(derivative(system, at, z, now))[0] for at in (t, last))
    return jnp.max(jnp.abs(after - before)) <= _SAME * jnp.max(jnp.abs(before))


def is_family(record: Recorded, system: TracedSystem, grid: Grid, inputs: Inputs) -> Bool[Array, ""]:
    """Whether cycles beside the one near the values of `initial()` close too, so that Newton's method has no single one
    to find: the shortest corrections lead to where the equations are singular.
    """
    cycle, until = _Cycle(record, system, grid, inputs), grid.until is not None

    def advance(k: Any, state: tuple[Vector, Array, Array]) -> tuple[Vector, Array, Array]:
        slopes, (left, sizes, end, _) = cycle.slopes(state[0])
        sizes = jnp.where(sizes > 0, sizes, 1.0)
        rows = sizes.at[-1].set(jnp.abs(slopes[-1]) @ sizes) if until else sizes
        rotated, lengths, axes = jnp.linalg.svd(slopes * sizes[None] / rows[:, None])
        counts = lengths > _ALIKE
        following = state[0] - sizes * (axes.T @ jnp.where(counts, rotated.T @ (left / rows) / lengths, 0.0))
        sought = jnp.where(k == 0, state[0].at[-1].set(end), following) if until else following
        return sought, jnp.max(jnp.abs(left / rows)), counts.all()

    first = cycle.first
    _, missed, is_single = jax.lax.fori_loop(0, _CORRECTIONS, advance, (first, jnp.inf, True))
    return (missed <= _ALIKE) & ~is_single


class _Pass(NamedTuple):
    """What a pass over a grid says.

    - `left`: of the equations; `sizes`: of what is sought; `end`: about when the event that ends the grid happens,
      without derivatives, NaN if it does not; `taken`: the record.
    """

    left: Vector
    sizes: Vector
    end: Float[Array, ""]
    taken: Record


class _Newton(NamedTuple):
    """Where Newton's method is on its way to a cycle.

    - `sought`: the point to try; `base`, `step`: the last good one, and the correction there; `length`: of it,
      relative; `damping`: the part of it that is tried; `slopes`: the derivatives at the last good point.
    """

    sought: Vector
    base: Vector
    step: Vector
    length: Float[Array, ""]
    damping: Float[Array, ""]
    slopes: Float[Array, "n n"]
    tried: Int[Array, ""]
    goes_on: Bool[Array, ""]


class _Cycle(NamedTuple):
    """A grid that repeats: the initial states are sought, then the final time if it ends by an event. The states at the
    end, after the event, are those at the start.
    """

    record: Recorded
    system: TracedSystem
    grid: Grid
    inputs: Inputs

    def over(self, sought: Vector, asked: Asked) -> _Pass:
        """A pass from these initial states, to this final time."""
        grid, until, inputs = self.grid, self.grid.until, self.inputs
        states = sought if until is None else sought[:-1]
        grid = grid if until is None else grid.ending(sought[-1])
        taken = self.record(self.system.beginning(states), grid, inputs, asked)
        rows, now = taken.history[STATES], inputs_on(grid, inputs)
        sizes = jnp.max(jnp.abs(rows), axis=0)
        shapes = jax.eval_shape(lambda: initial_state(self.system, grid.t_start, now(grid.t_start)))
        kin = np.repeat(np.arange(len(shapes)), [math.prod(one.shape) for one in shapes])
        if len(shapes) < len(kin):  # one may be zero throughout: the numbers of a state share the largest magnitude
            sizes = jnp.zeros(len(shapes)).at[kin].max(sizes)[kin]
        if until is None:
            return _Pass(rows[-1] - states, sizes, jnp.asarray(jnp.nan), taken)
        level, end = _level_along(self.system, grid, inputs, rows)
        where = list(self.system.declared_events).index(until)
        named = ravel_pytree(initial_state(self.system, grid.t_start, now(grid.t_start)))[1]
        arrived = after_events(self.system, grid.t_final, named(rows[-1]), now(grid.t_final))[where]
        left = jnp.append(arrived - states, level)
        return _Pass(left, jnp.append(sizes, grid.duration), end, taken)

    def slopes(self, sought: Vector) -> tuple[Float[Array, "n n"], _Pass]:
        """The derivatives of what is left of the equations by what is sought."""

        def left(sought: Vector) -> tuple[Vector, _Pass]:
            one = self.over(sought, ONLY_STATES)
            return one.left, one

        return jax.jacfwd(left, has_aux=True)(sought)

    @property
    def first(self) -> Vector:
        """The values of `initial()`, with the latest end where an event ends the cycle."""
        grid = self.grid
        first, _ = ravel_pytree(initial_state(self.system, grid.t_start, inputs_on(grid, self.inputs)(grid.t_start)))
        return first if grid.until is None else jnp.append(first, grid.t_final)

    def monodromy(self, sought: Vector) -> Float[Array, "states states"]:
        """The derivatives of the states after one cycle by those before it."""
        slopes, _ = self.slopes(sought)
        if self.grid.until is None:
            return slopes + jnp.eye(len(slopes))
        # The time of the event moves with the initial states.
        own = slopes[:-1, :-1] - jnp.outer(slopes[:-1, -1], slopes[-1, :-1]) / slopes[-1, -1]
        return own + jnp.eye(len(own))

    def begun(self) -> tuple[Vector, Float[Array, "n n"]]:
        """The cycle that Newton's method finds from the initial states of the system, and the inverse of the
        derivatives there: all without derivatives of their own.

        NaN where it does not converge. A step that does not shorten the next one is tried in part.
        """
        still = _Cycle(self.record, *jax.tree.map(_stilled, (self.system, self.grid, self.inputs)))
        grid, until, first = still.grid, still.grid.until is not None, still.first

        def advance(state: _Newton) -> _Newton:
            slopes, (left, sizes, end, _) = still.slopes(state.sought)
            step = jnp.linalg.solve(slopes, left)
            length = jnp.max(jnp.abs(step) / jnp.where(sizes > 0, sizes, 1.0))
            seeks = (state.tried == 0) & until
            is_good = seeks | (length <= state.length)
            base, step, slopes, length = (
                jnp.where(is_good, new, old)
                for new, old in zip(
                    (state.sought, step, slopes, length),
                    (state.base, state.step, state.slopes, state.length),
                    strict=True,
                )
            )
            damping = jnp.where(is_good, jnp.minimum(2 * state.damping, 1.0), state.damping / 4)
            found = state.sought.at[-1].set(end) if until else state.sought
            on = seeks | ((length > CLOSE) & (damping >= _LEAST) & (state.tried < _MOST))
            return _Newton(
                jnp.where(seeks, found, base - damping * step),
                base,
                step,
                jnp.where(seeks, jnp.inf, length),
                jnp.where(seeks, 1.0, damping),
                slopes,
                state.tried + 1,
                on,
            )

        zero, none = nothing(first)
        unknown = zero + jnp.eye(first.size)
        start = _Newton(first, first, 0 * first, zero + jnp.inf, zero + 1, unknown, none, none == 0)
        end = jax.lax.while_loop(lambda state: state.goes_on, advance, start)
        is_closed = end.length <= CLOSE
        if until:
            is_closed &= end.sought[-1] - grid.t_start > _SHORTEST * jnp.asarray(grid.step)
        return jnp.where(is_closed, end.sought, jnp.nan), jnp.linalg.inv(end.slopes)


def _stilled(leaf: Any) -> Any:
    """A number without derivatives."""
    return stop_gradient(leaf) if eqx.is_array(leaf) else leaf


def _level_along(
    system: System, grid: Grid, inputs: Inputs, rows: Float[Array, "instants states"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The function of the event that ends a cycle, at its end; and about when it happens between two instants, without
    derivatives, NaN if it does not.
    """
    assert grid.until is not None
    where, direction = list(system.declared_events).index(grid.until), system.declared_events[grid.until].direction
    now = inputs_on(grid, inputs)
    named = ravel_pytree(initial_state(system, grid.t_start, now(grid.t_start)))[1]

    def at(t: Array, row: Vector) -> tuple[Array, Array]:
        z, u = named(row), now(t)
        slopes = jnp.ones(()), derivative(system, t, z, u)
        return level_and_rate(lambda t, z: event_levels(system, t, z, now(t))[where], (t, z), slopes)

    level, rate = jax.vmap(at)(grid.times, rows)
    rate = rate * jnp.asarray(grid.step)  # in a step, as elsewhere
    known = stop_gradient((level[:-1], rate[:-1], level[1:], rate[1:]))
    crosses = crosses_zero(*known, direction)
    # A cycle starts where the one before ended, up to the error of the guess.
    reached = jax.lax.cummax(jnp.abs(level) if direction == 0 else -direction * level)
    first = jnp.argmax(crosses)
    later = crosses & (np.arange(crosses.size) > first)
    before_next = reached[jnp.where(later.any(), jnp.argmax(later), crosses.size)]
    crosses = jnp.where(stop_gradient(reached[first] < _AT_START * before_next), later, crosses)
    k = jnp.argmax(crosses)
    end = stop_gradient(grid.times[k] + _crossing_of(*known)[k] * grid.step)
    return level[-1], jnp.where(crosses.any(), end, jnp.nan)


def _crossing_of(level: Array, rise: Array, level_at: Array, rise_at: Array) -> Array:
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
