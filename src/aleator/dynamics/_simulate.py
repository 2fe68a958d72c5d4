"""`simulate`: the outputs of one realised system."""

import warnings
from collections.abc import Collection, Mapping

import numpy as np

from aleator._core.arrays import numbers_to_arrays
from aleator._core.border import one_of, refusal, shown
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import GridWarning, ProblemError, SimulationWarning
from aleator._core.leaves import is_traced
from aleator.dynamics._algebraic import AlgebraicSystem
from aleator.dynamics._equations import INSIDE
from aleator.dynamics._grid import AbstractGrid, Grid, Inputs
from aleator.dynamics._integrators import AbstractFixedStep, AbstractIntegrator
from aleator.dynamics._phases import Phases
from aleator.dynamics._record import Asked, History
from aleator.dynamics._simulation import Simulation, simulation_of
from aleator.dynamics._switches import jump_times, time_switches
from aleator.dynamics._system import AbstractSystem, System


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
    costs fixed steps their order, a `GridWarning`. Equations are traced at each call and compiled once: the same with
    other numbers take milliseconds.

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
        if inside.factor > 1:
            finer = simulation.on(grid.finer(inside.factor), simulation.integrator.reference())
            return finer.record(asked).thinned(inside.factor).outputs
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
        warnings.warn(
            f"{simulation.system.title}: its rates jump at t = {times[0]:.4g} s"
            f"{f' and {times.size - 1} more times' if times.size > 1 else ''}, and a step of "
            f"{type(simulation.integrator).__name__} that meets a jump is of first order. Declare it: let the "
            "equations depend on an input such as al.StepFunction([time], [before, after]), or an al.Tabulated that "
            "has the time twice. Or let steps adapt to it, al.integrators.Tsit5().",
            GridWarning,
            stacklevel=4,
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
    warnings.warn(
        f"{simulation.system.title}: output '{name}' is not finite{when}. "
        f"{why or 'Check the equations and their numbers there, or take more steps.'}",
        SimulationWarning,
        stacklevel=3,
    )
