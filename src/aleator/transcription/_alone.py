"""One system of a problem's family by itself: what its expressions and functionals are for it."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.collocation import Collocation
from aleator.design import AbstractFunctional, OneSystem, Problem, functionals_of, step_at
from aleator.uncertainty import named_numbers


class Alone(NamedTuple):
    """One system of the family: a problem's expressions for it, then its functionals."""

    expressions: tuple[Float[np.ndarray, "..."], ...]
    functionals: tuple[Float[np.ndarray, "..."], ...]


def middle(collocation: Collocation) -> int:
    """Which collocation point is closest to the mean of all."""
    points, weights = np.asarray(collocation.points), np.asarray(collocation.weights)
    away = points - weights @ points
    size = np.sqrt(weights @ away**2)
    return int(np.argmin(np.sum((away / np.where(size > 0, size, 1.0)) ** 2, axis=1)))


def alone(
    problem: Problem, values: Mapping[AbstractFunctional, Array], decisions: Float[Array, " n"]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """The parts of `Alone` from the functionals of one system."""
    scope = OneSystem(values, named_numbers(problem.model, decisions), step_at(problem, decisions))
    expressions = tuple(jnp.asarray(one.evaluate(scope)) for one in problem.expressions)
    return expressions, tuple(values[one] for one in functionals_of(problem.expressions))
