"""The response of a problem's system, realisation by realisation, and the numbers of its model."""

from typing import Any, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.design._declaration import AbstractProblem
from aleator.design._expression import Expression
from aleator.design._scope import AbstractScope
from aleator.design._statistic import AbstractFunctional, Statistic
from aleator.dynamics import AbstractGrid, AlgebraicSystem, History, explain_failure, simulate
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import at_means, named_numbers, realise


def history(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> History:
    """Time histories of all outputs of one realisation."""
    system, inputs, grid = realise(problem.model, germ, decisions)
    return simulate(system, grid, inputs, problem.integrator)


def grid_at(problem: AbstractProblem, decisions: Float[Array, " n"]) -> AbstractGrid:
    """The problem's grid, its final time as decided."""
    return realise(at_means(problem.model), jnp.zeros(0), decisions).grid


def responses(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> tuple[Float[Array, "points ..."], ...]:
    """Each functional at each germ point: a tuple of arrays whose first axis is the points."""
    needed = {name for functional in functionals for name in functional.outputs}

    def one(point: Float[Array, " variables"]) -> tuple[Array, ...]:
        system, inputs, grid = realise(problem.model, point, decisions)
        outputs = simulate(system, grid, inputs, problem.integrator, only=needed)
        return tuple(functional.evaluate(outputs, grid) for functional in functionals)

    return jax.vmap(one)(germ)


def unsolved(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> str:
    """Why the equations of one realisation of an algebraic system have no solution; empty if they have one."""
    system, _, _ = realise(problem.model, germ, decisions)
    return explain_failure(system) if isinstance(system, AlgebraicSystem) else ""


@final
class _Numbers(AbstractScope):
    """The model's own numbers, and no statistics."""

    def __init__(self, problem: AbstractProblem, decisions: Any):
        self._numbers = named_numbers(problem.model, jnp.asarray(decisions))

    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Array:
        received = Statistic(functionals, kind).text()
        raise ProblemError(f"Only the model's own numbers are known here; received {received}.")

    @property
    def weights(self) -> Array:
        raise ProblemError("Only the model's own numbers are known here; received an integral over time.")

    def value(self, name: str) -> Array:
        return self._numbers[name]


def value_at(expression: Expression, problem: AbstractProblem, decisions: Any) -> float:
    """An expression of the model's own numbers alone, such as a cost, at given decisions."""
    return float(expression.evaluate(_Numbers(problem, decisions)))
