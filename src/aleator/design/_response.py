"""The response of a problem's system: its functionals, realisation by realisation."""

import jax
from jaxtyping import Array, Float

from aleator.design._declaration import AbstractProblem
from aleator.design._language import AbstractFunctional
from aleator.dynamics import History, simulate
from aleator.uncertainty import realise


def history(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> History:
    """Time histories of all outputs of one realisation."""
    system, inputs = realise(problem.model, germ, decisions)
    return simulate(system, problem.grid, inputs, problem.integrator)


def responses(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> tuple[Float[Array, "points ..."], ...]:
    """Each functional at each germ point: a tuple of arrays whose first axis is the points."""

    def one(point: Float[Array, " variables"]) -> tuple[Array, ...]:
        outputs = history(problem, point, decisions)
        return tuple(functional.evaluate(outputs, problem.grid) for functional in functionals)

    return jax.vmap(one)(germ)
