"""Motions of a design: its inputs, states and outputs over time, of the systems of its expansion or of random ones."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import NUMBER, jax_array, numbers_to_arrays, refuse_beyond_memory
from aleator._core.border import one_of, refusal, whole
from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, output_units, uncertain
from aleator.dynamics import STATES, Asked, Grid, System, named, observation
from aleator.dynamics._grid import sampled
from aleator.ensemble import draw, in_batches, inputs_at, listed, refuse_nonfinite
from aleator.solution import Moments, Motions, Solution
from aleator.statistics import Mean, Std
from aleator.trajectories import AbstractSignal, Tabulated, instants
from aleator.transcription._discretised import discretised
from aleator.uncertainty import at_means, realise, uncertain_numbers


class Histories(NamedTuple):
    """Inputs, states and outputs of some systems by name, and their uncertain numbers."""

    inputs: dict[str, Float[Array, "systems instants ..."]]
    states: dict[str, Float[Array, "systems instants ..."]]
    outputs: dict[str, Float[Array, "systems ..."]]
    numbers: dict[str, Float[Array, " systems"]]


def _simulated(problem: Problem, germ: Float[Array, "systems variables"], decisions: Float[Array, " n"]) -> Histories:
    """Simulated from the start."""

    def one(point: Float[Array, " variables"]) -> Histories:
        simulation = realise(problem.simulation, point, decisions)
        numbers = uncertain_numbers(problem.placements, point, decisions)
        if not problem.system.has_time:
            return Histories({}, {}, {name: value[0] for name, value in simulation.history().items()}, numbers)
        record = simulation.record(Asked(states=problem.is_integrated))
        history, inputs, states = record.outputs, {}, {}
        for phase, part in simulation.phases.items():
            system, grid = part.traced, record.grid.of(f"{phase}.")
            assert isinstance(system, System)
            signals = part.signals(system)
            inputs |= named({phase: sampled({name: signals[name] for name in part.inputs}, grid, grid.fractions)})
            rows = history.pop(next(iter(named({phase: {STATES: None}}))), None)
            states |= named({phase: jax.vmap(part.unravelled)(rows)._asdict()}) if system.states else {}
        return Histories(inputs, states, history, numbers)

    return jax.vmap(one)(germ)


_SIMULATED = Compiled(_simulated, use=Use.ONCE)


class _Phase(NamedTuple):
    """The states of systems at the points of the mesh of a phase, and how long it lasts where an event ends it."""

    states: Float[Array | np.ndarray, "systems points states"]
    duration: Float[Array | np.ndarray, "systems durations"]


def _on_mesh(
    problem: Problem,
    systems: tuple[Array, list[_Phase]],
    along: tuple[Float[Array, " n"], list[Float[Array, " _"]]],
) -> Histories:
    """The same at the points of a mesh, from the states there: nothing is simulated."""
    decisions, fractions = along

    def one(system_at: tuple[Array, list[_Phase]]) -> Histories:
        point, phases = system_at
        whole, inputs, states, outputs = realise(problem.simulation, point, decisions), {}, {}, {}
        assert whole.traced is not None  # the equations of all phases are known
        for (phase, simulation), at, known in zip(whole.phases.items(), fractions, phases, strict=True):
            system, grid = simulation.traced, simulation.grid
            assert isinstance(system, System)
            assert isinstance(grid, Grid)
            signals, grid = (
                simulation.signals(system),
                grid.ending(grid.t_start + known.duration[0]) if grid.until else grid,
            )
            values = sampled(signals, grid, at)
            named_states = jax.vmap(simulation.unravelled)(known.states)
            times = instants(at, grid.t_start, grid.t_final)
            seen = jax.vmap(lambda *here, system=system: observation(system, *here))(times, named_states, values)
            inputs |= named({phase: {name: values[name] for name in simulation.inputs}})
            states |= named({phase: named_states._asdict()})
            outputs |= named({phase: ({"time": times} if grid.until else {}) | seen})
        return Histories(inputs, states, outputs, uncertain_numbers(problem.placements, point, decisions))

    return jax.vmap(one)(systems)


_ON_MESH = Compiled(_on_mesh, use=Use.ONCE)


def motions(solution: Solution, kind: str) -> Motions:
    """`inputs`, `states` or `outputs` of a solution: in each system of its expansion, with the moments of this.

    They are simulated anew, but where states were variables of the program: these stand for themselves.
    """
    problem, known = solution.problem, solution.mesh_states
    collocation = discretised(problem).collocation
    points = np.asarray(collocation.points)
    if known is None:
        histories = _histories(f"solution.{kind}", problem, points, solution.vector)
        times, where = _instants(solution), problem.grid.where
    else:
        phases, count, none = problem.simulation.phases, len(points), np.zeros((len(points), 0))
        each = [_Phase(known.rows(one)[:count], known.durations.get(one, none)[:count]) for one in phases]
        along = jax_array(solution.vector), [jax_array(known.fractions(one)) for one in phases]
        systems = jax.tree.map(jax_array, (points, each))
        histories = jax.tree.map(np.asarray, _ON_MESH(numbers_to_arrays(problem), systems, along))
        times, where = known.times, known.where

    def moments(values: Float[np.ndarray, "systems ..."]) -> Moments:
        coefficients = collocation.coefficients(jax_array(values))
        return Moments(*(np.asarray(statistic.of(coefficients, ())) for statistic in (Mean(), Std())))

    return _motions(problem, histories, kind, times, moments, where)


def simulate_systems(solution: Solution, samples: int = 100, *, seed: int = 0) -> Motions:
    """All outputs over time of random systems at a design, with their sampled means and standard deviations.

    - `samples`: how many systems, drawn from `seed`; a design of which nothing is uncertain is one system. A solution
      of `al.deterministic(problem)` is simulated with the uncertainty of `problem`, as by `al.validate`.

    Returns a mapping from names to `xarray.Dataset` (see `Motions`). Raises `ProblemError` for other arguments, or for
    more systems than fit into memory, and `SimulationError` for a system that is not finite, naming its numbers.
    """
    one_of("simulate_systems: solution", solution, Solution)
    samples, seed = whole("simulate_systems: samples", samples), whole("simulate_systems: seed", seed, least=0)
    problem = uncertain(solution.problem)
    germs = tuple(problem.placements.germs.values())
    equations = problem.simulation.equations
    numbers = 0 if equations is None else sum(math.prod(shape) for shape in equations.output_shapes().values())
    size = NUMBER * samples * (len(germs) + numbers * (problem.grid.steps + 1))
    refuse_beyond_memory(f"simulate_systems: {samples} systems", size, "Simulate fewer.")
    points = draw(germs, samples, np.random.default_rng(seed)) if germs else np.zeros((1, 0))
    histories = _histories("simulate_systems", problem, points, solution.vector)

    def moments(values: Float[np.ndarray, "systems ..."]) -> Moments:
        return Moments(values.mean(axis=0), values.std(axis=0, ddof=int(len(values) > 1)))

    return _motions(problem, histories, "outputs", _instants(solution), moments, problem.grid.where)


def signal_of(solution: Solution, name: str) -> AbstractSignal:
    """An input at the means of all uncertain numbers, or the mean of an output, as a function of time."""
    problem = solution.problem
    if name in problem.inputs:
        certain = realise(at_means(problem.simulation), jnp.zeros(0), jax_array(solution.vector))
        grid = certain.grid.of(name)
        return certain.inputs[name].over(grid.t_start, grid.t_final)
    outputs = solution.outputs
    if name not in outputs or outputs.times is None:
        known = dict.fromkeys([*problem.inputs, *([] if outputs.times is None else outputs)])
        raise refusal("solution.signal: name", f"one of the inputs and outputs {list(known)}", name)
    times = np.asarray(outputs.times_of(name))
    begun = 0.0 if isinstance(problem.grid, Grid) else times[0] - problem.grid.of(name).t_start
    return Tabulated(times - begun, outputs.moments[name].mean)


def _instants(solution: Solution) -> Float[np.ndarray, " instants"] | None:
    return solution.instants if solution.problem.system.has_time else None


def _histories(
    who: str, problem: Problem, points: Float[np.ndarray, "systems variables"], vector: Float[np.ndarray, " n"]
) -> Histories:
    """Systems simulated at some germ points. Raises `SimulationError` for one that is not finite."""
    decisions = jax_array(vector)
    histories = in_batches(_SIMULATED, numbers_to_arrays(problem), points, decisions)

    def numbers_at(i: int) -> str:
        return listed(inputs_at(problem.placements, points[i], decisions))

    refuse_nonfinite(who, histories.outputs, numbers_at)
    return histories


def _motions(
    problem: Problem,
    histories: Histories,
    kind: str,
    times: Float[np.ndarray, " instants"] | None,
    moments: Callable[[np.ndarray], Moments],
    where: Callable[[str], slice],
) -> Motions:
    # What is traced comes back in alphabetical order.
    inputs = named({phase: part.inputs for phase, part in problem.simulation.phases.items()})
    declared = {"inputs": inputs, "states": getattr(problem.system, "states", ())}
    traced = getattr(histories, kind)
    systems = {name: traced[name] for name in declared.get(kind, traced)}
    each = {name: moments(values) for name, values in systems.items()}
    return Motions(kind, times, systems, each, histories.numbers, output_units(problem), where)
