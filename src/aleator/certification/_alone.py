"""One system of a problem's family by itself: the values of expressions and functionals for it."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    AbstractFunctional,
    OneSystem,
    Problem,
    functionals_of,
    responses,
    step_at,
)
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.trajectories import least_steps
from aleator.uncertainty import named_numbers

# The other instants come from a prime number of steps: at least this many, and this many times those of the finer grid.
_STEPS, _BEYOND = 4099, 1.5


class Alone(NamedTuple):
    """One system of the family: a problem's expressions for it, then its functionals."""

    expressions: tuple[Float[np.ndarray, "..."], ...]
    functionals: tuple[Float[np.ndarray, "..."], ...]


def middle(collocation: Collocation) -> int:
    """The index of the collocation point that is closest to the mean of all."""
    points, weights = np.asarray(collocation.points), np.asarray(collocation.weights)
    away = points - weights @ points
    size = np.sqrt(weights @ away**2)
    return int(np.argmin(np.sum((away / np.where(size > 0, size, 1.0)) ** 2, axis=1)))


def alone(
    problem: Problem, values: Mapping[AbstractFunctional, Array], decisions: Float[Array, " n"]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """The parts of `Alone` from the functionals of one system."""
    scope = OneSystem(values, named_numbers(problem.simulation, decisions), step_at(problem, decisions))
    expressions = tuple(jnp.asarray(one.evaluate(scope)) for one in problem.expressions)
    return expressions, tuple(values[one] for one in functionals_of(problem.expressions))


def _elsewhere(problem: Problem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> tuple:
    functionals = functionals_of(problem.expressions)
    found = responses(problem, functionals, germ[None], decisions)
    return alone(problem, dict(zip(functionals, (one[0] for one in found), strict=True)), decisions)


ELSEWHERE = Compiled(_elsewhere, use=Use.ONCE)


def alone_elsewhere(
    problem: Problem, collocation: Collocation, decisions: Float[np.ndarray, " n"], factor: int
) -> Callable[[], Alone]:
    """The system in the middle of a problem's family, at a few thousand instants that no grid of the problem has.

    It is simulated on another core; the function returned waits for the result.

    A grid and those with a whole multiple of its steps share their instants. A ripple whose period is one step is
    constant at all of them, and a shock between two of them is invisible. A prime number of steps gives other instants,
    and more of them than the grid of `factor` times as many steps.
    """
    assert isinstance(problem.grid, Grid)
    # The nodes of controls are instants of every grid.
    whole = least_steps((problem.system, problem.inputs))
    steps = whole * _prime_from(-(-max(_STEPS, int(_BEYOND * factor * problem.grid.steps)) // whole))
    there = numbers_to_arrays(problem.on_grid(problem.grid.divided(steps)))
    point = jax_array(np.asarray(collocation.points)[middle(collocation)])
    found = ELSEWHERE.begin(there, point, jax_array(decisions))
    return lambda: Alone(*jax.tree.map(np.asarray, found()))


def _prime_from(number: int) -> int:
    return next(one for one in range(number, 2 * number) if all(one % k for k in range(2, int(one**0.5) + 1)))
