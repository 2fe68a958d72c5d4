"""`simulate`: the outputs of one realised system, over time or at the one instant of an algebraic system."""

from aleator._core.errors import ProblemError
from aleator.dynamics._algebraic import AlgebraicSystem, algebraic_outputs
from aleator.dynamics._grid import AbstractGrid, Grid, Instant
from aleator.dynamics._integrators import AbstractIntegrator, History, Inputs, RungeKutta4
from aleator.dynamics._system import System, check_inputs


def simulate(
    system: System | AlgebraicSystem,
    grid: AbstractGrid | None = None,
    inputs: Inputs | None = None,
    integrator: AbstractIntegrator | None = None,
) -> History:
    """Outputs of one realised system (plain numbers in its fields) at every instant, by name: shape (instants, ...).

    The default integrator is `RungeKutta4`. An `AlgebraicSystem` knows one instant, takes no inputs and needs no
    integrator: `simulate(system)`. Where its equations are not solved, or an adaptive integrator gives up, the outputs
    are not a number.

    Raises `ProblemError` if grid or inputs do not fit the system.
    """
    if isinstance(system, AlgebraicSystem):
        return _solved(system, Instant() if grid is None else grid, inputs or {})
    if not isinstance(grid, Grid):
        raise ProblemError(
            f"{type(system).__name__} moves in time: expected a grid, such as al.Grid(t_final, steps); "
            f"received {type(grid).__name__}."
        )
    check_inputs(system, inputs or {})
    return (integrator or RungeKutta4()).outputs(system, grid, inputs or {})


def _solved(system: AlgebraicSystem, grid: AbstractGrid, inputs: Inputs) -> History:
    name = type(system).__name__
    if not isinstance(grid, Instant):
        raise ProblemError(
            f"{name} is algebraic and knows no time: expected al.Instant() as its grid; received {type(grid).__name__}."
        )
    if inputs:
        raise ProblemError(f"{name} is algebraic and takes no inputs; received {sorted(inputs)}.")
    return {output: value[None] for output, value in algebraic_outputs(system).items()}
