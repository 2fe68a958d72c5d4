"""`simulate`: the outputs of one realised system, over time or at the one instant of an algebraic system."""

from collections.abc import Collection, Mapping

from aleator._core.errors import ProblemError
from aleator._core.given import one_of, refusal
from aleator.dynamics._algebraic import AlgebraicSystem, algebraic_outputs
from aleator.dynamics._grid import AbstractGrid, Grid, Instant
from aleator.dynamics._instantaneous import observed
from aleator.dynamics._integrators import AbstractIntegrator, Inputs, RungeKutta4
from aleator.dynamics._record import Asked, History, Record, chosen
from aleator.dynamics._refusals import check_signals, refuse_unrealised
from aleator.dynamics._system import System, state_type


def simulate(
    system: System | AlgebraicSystem,
    grid: AbstractGrid | None = None,
    inputs: Inputs | None = None,
    integrator: AbstractIntegrator | None = None,
    *,
    only: Collection[str] | None = None,
) -> History:
    """Outputs of one realised system (plain numbers in its fields) at every instant, by name: shape (instants, ...).

    The default integrator is `RungeKutta4`. An `AlgebraicSystem` knows one instant, takes no inputs and needs no
    integrator: `simulate(system)`. A system without states is not integrated either: its outputs follow from its inputs
    at each instant. `only` lists the outputs that are asked for, by name. Where its equations are not solved, or an
    adaptive integrator gives up, the outputs are not a number.

    Raises `ProblemError` if a distribution or a decision is left in system, grid or inputs, if grid or inputs do not
    fit the system, if a signal is not known on the whole grid (unless it is traced), or outputs are asked for that the
    system does not have.
    """
    one_of("simulate: system", system, (System, AlgebraicSystem))
    if not isinstance(inputs, Mapping | None):
        raise refusal("simulate: inputs", "signals by name, such as {'road': ...}", inputs)
    if integrator is not None:
        one_of("simulate: integrator", integrator, AbstractIntegrator, "al.RungeKutta4()")
    if only is not None and (isinstance(only, str) or not isinstance(only, Collection)):
        raise refusal("simulate: only", "a list of outputs by name, such as ['x']", only)
    return record(system, grid, inputs, integrator, Asked(None if only is None else frozenset(only))).history


def record(
    system: System | AlgebraicSystem,
    grid: AbstractGrid | None,
    inputs: Inputs | None,
    integrator: AbstractIntegrator | None,
    asked: Asked,
) -> Record:
    """What is asked of one realised system; see `simulate`, which asks for outputs at the instants alone."""
    inputs = inputs or {}
    refuse_unrealised(system=system, grid=grid, inputs=inputs)
    if isinstance(system, AlgebraicSystem):
        found = _solved(system, Instant() if grid is None else grid, inputs)
        return Record(chosen(system, found, asked.instants), {}, ())
    if not isinstance(grid, Grid):
        raise ProblemError(
            f"{type(system).__name__} moves in time: expected a grid, such as al.Grid(t_final, steps); "
            f"received {type(grid).__name__}."
        )
    state_type(system.states)
    check_signals(system, grid, inputs)
    if asked.instants is not None:
        system = system.focused(asked.instants | asked.nodes | asked.integrated)
    if not system.states:
        return observed(system, grid, inputs, asked)
    return (integrator or RungeKutta4()).record(system, grid, {**system.signals(), **inputs}, asked)


def _solved(system: AlgebraicSystem, grid: AbstractGrid, inputs: Inputs) -> History:
    name = type(system).__name__
    if not isinstance(grid, Instant):
        raise ProblemError(
            f"{name} is algebraic and knows no time: expected al.Instant() as its grid; received {type(grid).__name__}."
        )
    if inputs:
        raise ProblemError(f"{name} is algebraic and takes no inputs; received {sorted(inputs)}.")
    return {output: value[None] for output, value in algebraic_outputs(system).items()}
