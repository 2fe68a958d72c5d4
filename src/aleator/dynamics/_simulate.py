"""`simulate`: the outputs of one realised system; and jumps over time that nothing declares.

A comparison of the time, read off the equations, tells that something may jump; that it does, and when, is seen in the
values on both sides.
"""

from collections.abc import Collection, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import tree_leaves_with_path
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.border import one_of, refusal, shown
from aleator._core.compilation import Compiled, Use
from aleator._core.equations import TIME, Marks, switches
from aleator._core.errors import GridWarning, ProblemError, SimulationWarning, warn_outside
from aleator._core.leaves import is_leaf, is_traced, named_leaves
from aleator.dynamics._algebraic import AlgebraicSystem
from aleator.dynamics._equations import INSIDE
from aleator.dynamics._evaluation import derivative_and_observation, initial_state, observation
from aleator.dynamics._grid import AbstractGrid, Grid, Inputs, inputs_on
from aleator.dynamics._integrators import AbstractFixedStep, AbstractIntegrator
from aleator.dynamics._phases import Phases
from aleator.dynamics._record import Asked, History
from aleator.dynamics._simulation import Simulation, simulation_of
from aleator.dynamics._system import AbstractSystem, System
from aleator.trajectories import jumps_of

# Intervals of the duration in which jumps are sought, and how often each is halved.
_MOST_INTERVALS, _HALVED = 500, 36
# Times that differ by less than this part of the duration are the same jump.
_SAME = 1e-9
# A change within no time that is larger than this part of a number's largest value is a jump.
_JUMP = 1e-6
# A number counts as this part of the largest one at least: its changes by less than `_JUMP` of that may be rounding.
_ROUNDING = 1e-7
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

    jaxpr = jax.make_jaxpr(told)(arrays, np.zeros(())).jaxpr
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


def simulate(
    system: AbstractSystem | Phases,
    grid: AbstractGrid | None = None,
    inputs: Inputs | None = None,
    integrator: AbstractIntegrator | None = None,
    *,
    only: Collection[str] | None = None,
) -> History:
    """Simulate one realised system (plain numbers in its fields): all outputs at every instant, by name.

    Returns a dict of arrays of shape (instants, ...). The default integrator is `RungeKutta4`. An `AlgebraicSystem` has
    one instant and takes no grid, inputs or integrator: `simulate(system)`. A system without states is not integrated
    either: its outputs follow from its inputs at each instant. `Phases` have grids and inputs of their own, and the
    output `m` of the phase `ascent` is returned as `"ascent.m"`. Where an event ends the grid, the instants are
    returned as `"time"`, unless the system has an output of that name. `only` lists the names of the outputs wanted
    (default: all). Where equations could not be solved, or an adaptive integrator gives up, the outputs are NaN, and a
    `SimulationWarning` says so; where rates jump at a time that no input declares (`StepFunction`, `Tabulated`), which
    costs fixed steps their order, a `GridWarning`. Nothing else checks the steps here, as `al.solve` does: where they
    may be too long, compare with `grid.finer(3)` or let `al.integrators.Tsit5()` choose them. Equations are traced at
    each call and compiled once: the same with other numbers take milliseconds.

    Raises `ProblemError` if system, grid or inputs contain a distribution or a decision, if grid or inputs do not match
    the system, if a signal is not known on the whole grid (unless traced), or if `only` names an output that the system
    does not have.
    """
    one_of("simulate: system", system, (System, AlgebraicSystem, Phases))
    if isinstance(inputs, AbstractIntegrator):
        raise ProblemError(f"simulate: an integrator is given by name: integrator={shown(inputs)}.")
    if not isinstance(inputs, Mapping | None):
        raise refusal("simulate: inputs", "signals by name, such as {'road': ...}", inputs)
    if integrator is not None:
        one_of("simulate: integrator", integrator, AbstractIntegrator, "al.integrators.RungeKutta4()")
    if only is not None and (isinstance(only, str) or not isinstance(only, Collection)):
        raise refusal("simulate: only", "a list of outputs by name, such as ['x']", only)
    if isinstance(system, Phases) and any(phase.feedback is not None for phase in system.phases.values()):
        raise ProblemError("simulate: phases with feedback follow a plan: expected an al.Problem of them.")
    simulation = simulation_of(system, grid, inputs, integrator)
    history = _recorded(simulation, Asked(None if only is None else frozenset(only)))
    if not is_traced(history):
        _warn_of_what_is_not_finite(simulation, history)
    return history


def _recorded(simulation: Simulation, asked: Asked) -> History:
    """The outputs of `record`, by a program that serves the same equations with any other numbers.

    What no program can be compiled of, such as code that branches on a number, is simulated as it stands. Inside a
    model that is checked, on a finer grid.
    """
    grid, inside = simulation.grid, INSIDE.get()
    if inside is not None and simulation.system.has_time:
        inside.is_met = True
        if (factor := int(inside.factor)) > 1:
            finer = simulation.on(grid.finer(factor), simulation.integrator.reference())
            return finer.record(asked).thinned(factor).outputs
    first = next(iter(simulation.phases.values()))
    if is_traced(simulation):
        return _history(simulation, asked)
    if not isinstance(first.system, System):
        return _by_program(simulation, asked, grid)
    first.refuse_at_start(first.system)
    history = _by_program(simulation, asked, grid)
    if first.system.solves_start and not all(np.isfinite(np.asarray(rows[0])).all() for rows in history.values()):
        first.refuse_no_start(first.system)
    return history


def _by_program(simulation: Simulation, asked: Asked, grid: AbstractGrid) -> History:
    try:
        declared = simulation.declared()
    except Exception:
        return _history(simulation, asked)
    assert declared.equations is not None
    declared.equations.refuse_large_history(simulation.system.title, grid.steps, asked.instants)
    try:
        history = _HISTORY(numbers_to_arrays(declared), asked)
    except Exception:
        return _history(simulation, asked)
    for one in declared.phases.values():
        if isinstance(one.grid, Grid):
            _warn_of_jumps(one)
    return history


def _history(simulation: Simulation, asked: Asked) -> History:
    return simulation.record(asked).outputs


def _use(simulation: Simulation, asked: Asked) -> Use:
    """Steps that events divide are worth some optimisation."""
    del asked
    systems = (one.system for one in simulation.phases.values())
    return Use.ONCE if any(isinstance(one, System) and one.declared_events for one in systems) else Use.BRIEF


_HISTORY = Compiled(_history, use=_use)


def _warn_of_jumps(simulation: Simulation) -> None:
    """Warn (`GridWarning`) if rates jump at a time that is not declared, of which fixed steps know nothing."""
    if not (isinstance(simulation.integrator, AbstractFixedStep) and simulation.system.is_integrated):
        return
    times = jump_times(simulation) if time_switches(simulation) else np.zeros(0)
    if times.size:
        warn_outside(
            f"{simulation.system.title}: its rates jump at t = {times[0]:.4g} s"
            f"{f' and {times.size - 1} more times' if times.size > 1 else ''}, and a step of "
            f"{type(simulation.integrator).__name__} that meets a jump is of first order. Declare it: let the "
            "equations depend on an input such as al.StepFunction([time], [before, after]), or an al.Tabulated that "
            "has the time twice. Or let steps adapt to it, al.integrators.Tsit5().",
            GridWarning,
        )


def _warn_of_what_is_not_finite(simulation: Simulation, history: History) -> None:
    """Warn (`SimulationWarning`) if an output is not finite: the first one, when, and why if anything can tell."""
    broken = {name: ~np.isfinite(np.asarray(one)).reshape(len(one), -1).all(axis=1) for name, one in history.items()}
    first = {name: int(np.argmax(bad)) for name, bad in broken.items() if bad.any()}
    if not first:
        return
    grid, has_time = simulation.grid, simulation.system.has_time
    name = min(first, key=lambda one: (grid.where(one).start or 0) + first[one])
    when = f" at t = {float(np.asarray(grid.of(name).times)[first[name]]):.4g} s" if has_time else ""
    when = " at any instant" if has_time and np.all(broken[name]) else when
    why = simulation.explain() or (simulation.system.diagnose(grid) if has_time else "")
    warn_outside(
        f"{simulation.system.title}: output '{name}' is not finite{when}. "
        f"{why or 'Check the equations and their numbers there, or take more steps.'}",
        SimulationWarning,
    )
