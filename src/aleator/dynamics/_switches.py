"""Jumps over time that nothing declares: comparisons of the time, read off the equations, and where they take effect.

A comparison tells that something may jump; that it does, and when, is seen in the values on both sides.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import tree_leaves_with_path
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator._core.equations import TIME, Marks, switches
from aleator._core.leaves import is_leaf, named_leaves
from aleator.dynamics._evaluation import derivative_and_observation, initial_state, observation
from aleator.dynamics._grid import Grid, inputs_on
from aleator.dynamics._simulation import Simulation
from aleator.dynamics._system import System
from aleator.trajectories import jumps_of

# Intervals of the duration in which jumps are sought, and how often each is halved.
_MOST_INTERVALS, _HALVED = 500, 36
# Times that differ by less than this part of the duration are the same jump.
_SAME = 1e-9
# A change within no time that is larger than this part of a number's largest value is a jump.
_JUMP = 1e-6
# A number that is never larger than this part of the largest one may be rounding.
_ROUNDING = 1e-12
# How far the second state that is tried is off the first one.
_OFF = 0.1


def time_switches(simulation: Simulation, uncertain: Simulation | None = None) -> set[str]:
    """The names of the decided numbers with which the time is compared; "" if it is compared with anything at all.

    - `simulation`: a realised one by its equations; `uncertain`: what it realises, where something is decided.
    """
    equations, system = simulation.equations, simulation.system
    assert equations is not None
    declared, none = simulation if uncertain is None else uncertain, frozenset[str]()
    places = tree_leaves_with_path(declared, is_leaf=is_leaf)
    named = zip(places, named_leaves(declared), strict=True)
    decided = {place: frozenset([name]) for (place, leaf), (name, _) in named if _is_decided(leaf)}
    numbers = tree_leaves_with_path(numbers_to_arrays(simulation))
    marks = [decided.get(place, none) for place, number in numbers if eqx.is_array(number)]
    of_system = len(jax.tree.leaves(eqx.filter(numbers_to_arrays(system), eqx.is_array)))
    found = set[Marks]()
    for name in ("instant", "residual"):
        if name in equations:
            jaxpr = equations[name].closed.jaxpr
            given = [*marks[:of_system], frozenset([TIME])]
            found |= switches(jaxpr, [*given, *[none] * (len(jaxpr.invars) - len(given))])
    arrays, static = eqx.partition(numbers_to_arrays(simulation), eqx.is_array)

    def told(arrays: Any, t: Array) -> list[Array]:
        realised = eqx.combine(arrays, static)
        return [one.over(realised.grid.t_start, realised.grid.t_final)(t) for one in _opaque(realised)]

    jaxpr = jax.make_jaxpr(told)(arrays, jnp.zeros(())).jaxpr
    found |= switches(jaxpr, [*marks, frozenset([TIME])])
    return {name or "" for one in found if TIME in one for name in (one - {TIME} or [""])}


def _is_decided(leaf: Any) -> bool:
    """Whether a leaf is chosen, or a distribution of which a number is."""
    inside = jax.tree.leaves(leaf, is_leaf=lambda node: is_leaf(node) and node is not leaf)
    return is_leaf(leaf) and any(is_leaf(one) and not one.is_uncertain for one in [leaf, *inside])


def _opaque(simulation: Simulation) -> list[Any]:
    """The signals that may jump unseen: not those of which it is known."""
    system = simulation.traced
    signals = {**(system.signals() if isinstance(system, System) else {}), **simulation.inputs}
    return [one for one in signals.values() if not one.declares_jumps]


def jump_times(simulation: Simulation, *, in_outputs: bool = False) -> Float[np.ndarray, " jumps"]:
    """When rates (and outputs, if asked) jump at fixed states, s; jumps that are declared are left out.

    Each interval of the duration is halved towards the larger error of the trapezoidal rule. At two states, for at rest
    much is zero. NaN is no jump.
    """
    times, in_rates, anywhere, declared = map(np.asarray, _SOUGHT(numbers_to_arrays(simulation)))
    found = times[anywhere if in_outputs else in_rates]
    near = _SAME * float(simulation.grid.duration)  # type: ignore[attr-defined]
    found = found[np.diff(found, prepend=-np.inf) > near]
    return found[(np.abs(found[:, None] - declared) > near).all(axis=1)]


def _sought(
    simulation: Simulation,
) -> tuple[Float[Array, " n"], Bool[Array, " n"], Bool[Array, " n"], Float[Array, " jumps"]]:
    system, grid = simulation.traced, simulation.grid
    assert isinstance(system, System)
    assert isinstance(grid, Grid)
    signals = {**system.signals(), **simulation.inputs}
    now = inputs_on(grid, signals)
    start, named = ravel_pytree(initial_state(system, grid.times[0], now(grid.times[0])))
    states = jnp.stack([start, start + _OFF * (1 + jnp.abs(start)) * jnp.cos(jnp.arange(start.size))])

    def said(t: Array) -> Array:
        """Rates at both states, then outputs."""

        def at(state: Array) -> tuple[Array, Array]:
            z, inputs = named(state), now(t)
            both = derivative_and_observation if system.states else lambda *each: ((), observation(*each))
            rates, outputs = both(system, t, z, inputs)
            return ravel_pytree(rates)[0], ravel_pytree(outputs)[0]

        return jnp.nan_to_num(jnp.concatenate([one.ravel() for one in jax.vmap(at)(states)]))

    def known(t: Array) -> tuple[Array, Array]:
        return jax.jvp(said, (t,), (jnp.ones(()),))

    ends = jnp.linspace(grid.t_start, grid.t_final, min(grid.steps, _MOST_INTERVALS) + 1)
    size = jnp.max(jnp.abs(jax.vmap(said)(ends)), axis=0)
    size = jnp.maximum(size, _ROUNDING * jnp.max(size) + np.finfo(float).tiny)

    def error(low: Array, high: Array) -> Array:
        (first, slope), (last, later) = known(low), known(high)
        return jnp.max(jnp.abs(last - first - (high - low) / 2 * (slope + later)) / size)

    @jax.vmap
    def halved(low: Array, high: Array) -> tuple[Array, Array]:
        middle = (low + high) / 2
        is_first = error(low, middle) >= error(middle, high)
        return jnp.where(is_first, low, middle), jnp.where(is_first, middle, high)

    low, high = jax.lax.fori_loop(0, _HALVED, lambda _, each: halved(*each), (ends[:-1], ends[1:]))
    jumps = jax.vmap(lambda low, high: jnp.abs(said(high) - said(low)) > _JUMP * size)(low, high)
    in_rates = jnp.any(jumps[:, : states.size], axis=1)
    return high, in_rates, jnp.any(jumps, axis=1), jumps_of(signals, grid.t_start, grid.t_final)


_SOUGHT = Compiled(_sought, use=Use.BRIEF)
