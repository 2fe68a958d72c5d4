"""What a problem is made of, for all that reads problems: checks, responses, texts."""

from typing import NamedTuple

import equinox as eqx

from aleator._core.errors import ProblemError
from aleator._core.leaves import transparent
from aleator.design._expression import Constraint, Expression
from aleator.dynamics import AbstractGrid, AbstractIntegrator, AlgebraicSystem, System
from aleator.expansion import Expansion
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import Survey, survey


@transparent("system", "grid")
class Model(NamedTuple):
    """Everything that may hold distributions and decisions: the system, its inputs and the grid's final time."""

    system: System | AlgebraicSystem
    inputs: dict[str, AbstractSignal]
    grid: AbstractGrid


class AbstractProblem(eqx.Module):
    """The parts of a problem, and what follows from them. See `Problem`, its only implementation.

    `physics` stands for the traced equations, so that two problems whose code reads other globals, class attributes or
    closures are told apart where their fields are alike. It is that of the time of declaration: see `current`.
    """

    system: System | AlgebraicSystem
    grid: AbstractGrid
    inputs: dict[str, AbstractSignal]
    objective: Expression
    constraints: tuple[Constraint, ...]
    expansion: Expansion
    integrator: AbstractIntegrator
    physics: str = eqx.field(static=True)

    @property
    def model(self) -> Model:
        """The part of the problem that realisation acts on."""
        return Model(self.system, self.inputs, self.grid)

    @property
    def is_integrated(self) -> bool:
        """Whether its system has states, which are integrated over time."""
        return isinstance(self.system, System) and bool(self.system.states)

    @property
    def survey(self) -> Survey:
        """Its distributions and decisions."""
        return survey(self.model)

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
