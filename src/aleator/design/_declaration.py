"""The parts of a problem, as read by checks, responses and texts."""

import equinox as eqx

from aleator._core.equations import Digest
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, Printed
from aleator.design._expression import Constraint, Expression
from aleator.dynamics import AbstractGrid, AbstractIntegrator, AbstractSystem, Simulation
from aleator.expansion import Expansion
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import Placements, placements


class AbstractProblem(Module, Printed):
    """The parts of a problem and what follows from them; implemented by `Problem` alone.

    `physics` is the digest of its traced equations, with those of its expressions. All programs are built from the
    equations as they were declared: to change code, declare again.
    """

    simulation: Simulation
    objective: Expression
    constraints: tuple[Constraint, ...]
    expansion: Expansion
    physics: Digest = eqx.field(static=True)

    @property
    def is_declared(self) -> bool:
        """Whether its digest tells all code in it: not that of its own statistics, or behind `jax.pure_callback`."""
        return self.physics.is_whole

    @property
    def system(self) -> AbstractSystem:
        """The system."""
        return self.simulation.system

    @property
    def inputs(self) -> dict[str, AbstractSignal]:
        """A signal for each input of the system, by name."""
        return self.simulation.inputs

    @property
    def grid(self) -> AbstractGrid:
        """The instants."""
        return self.simulation.grid

    @property
    def integrator(self) -> AbstractIntegrator:
        """How states are advanced in time."""
        return self.simulation.integrator

    @property
    def is_integrated(self) -> bool:
        """Whether its system has states, which are integrated over time."""
        return self.system.is_integrated

    @property
    def placements(self) -> Placements:
        """Its distributions and decisions."""
        return placements(self.simulation)

    @property
    def expressions(self) -> tuple[Expression, ...]:
        """The objective, then the constraints' expressions."""
        return (self.objective, *(constraint.expression for constraint in self.constraints))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the constraints, each once."""
        return tuple(dict.fromkeys(constraint.name for constraint in self.constraints))

    def named(self, name: str) -> tuple[Constraint, ...]:
        """The constraints of one name. Raises `ProblemError` if there are none."""
        found = tuple(constraint for constraint in self.constraints if constraint.name == name)
        if not found:
            raise ProblemError(f"There is no constraint '{name}'; expected one of {list(self.names)}.")
        return found
