"""`simulate`: the outputs of one realised system, over time or at the one instant of an algebraic system."""

from collections.abc import Collection
from typing import Any

from jaxtyping import Array

from aleator._core.errors import ProblemError
from aleator.dynamics._algebraic import AlgebraicSystem, algebraic_outputs
from aleator.dynamics._grid import AbstractGrid, Grid, Instant
from aleator.dynamics._instantaneous import observed
from aleator.dynamics._integrators import AbstractIntegrator, History, Inputs, RungeKutta4
from aleator.dynamics._refusals import check_signals, refuse_unrealised
from aleator.dynamics._system import System, observation


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
    inputs = inputs or {}
    refuse_unrealised(system=system, grid=grid, inputs=inputs)
    if isinstance(system, AlgebraicSystem):
        return _chosen(system, _solved(system, Instant() if grid is None else grid, inputs), only)
    if not isinstance(grid, Grid):
        raise ProblemError(
            f"{type(system).__name__} moves in time: expected a grid, such as al.Grid(t_final, steps); "
            f"received {type(grid).__name__}."
        )
    check_signals(system, grid, inputs)
    system = system if only is None else system.focused(only)

    def observe(system: System, t: Any, z: Any, now: dict[str, Array]) -> dict[str, Array]:
        return _chosen(system, observation(system, t, z, now), only)

    if not system.states:
        return observed(system, grid, inputs, observe)
    return (integrator or RungeKutta4()).outputs(system, grid, {**system.signals(), **inputs}, observe)


def _chosen(system: Any, found: dict[str, Array], only: Collection[str] | None) -> dict[str, Array]:
    """The outputs that are asked for."""
    if only is None:
        return found
    if isinstance(only, str) or not set(only) <= set(found):
        raise ProblemError(
            f"{type(system).__name__}: expected in `only` a list of some of the outputs {list(found)}; "
            f"received {only!r}."
        )
    return {name: value for name, value in found.items() if name in only}


def _solved(system: AlgebraicSystem, grid: AbstractGrid, inputs: Inputs) -> History:
    name = type(system).__name__
    if not isinstance(grid, Instant):
        raise ProblemError(
            f"{name} is algebraic and knows no time: expected al.Instant() as its grid; received {type(grid).__name__}."
        )
    if inputs:
        raise ProblemError(f"{name} is algebraic and takes no inputs; received {sorted(inputs)}.")
    return {output: value[None] for output, value in algebraic_outputs(system).items()}
