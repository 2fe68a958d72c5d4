"""The model at given realisations: its excess over the limits on the worst case, and when."""

from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.certification._search import Points
from aleator.design import (
    Constraint,
    OneSystem,
    Problem,
    functionals_of,
    grid_at,
    is_worst_case,
    responses,
    step_at,
)
from aleator.ensemble import in_batches
from aleator.transcription import germ_box
from aleator.uncertainty import named_numbers


def worst_case_limits(problem: Problem) -> tuple[Constraint, ...]:
    """The limits on the worst case among a problem's constraints."""
    return tuple(one for one in problem.constraints if is_worst_case(one))


class Reached(NamedTuple):
    """Limits on the worst case at some realisations, each where it is closest to its bound or furthest beyond it.

    - `beyond`: the excess over the bound, negative inside; `value`: of the functional; `time`: when (s), NaN if the
      limit is not over time.
    """

    beyond: Float[np.ndarray, "points limits"]
    value: Float[np.ndarray, "points limits"]
    time: Float[np.ndarray, "points limits"]


def _reached(
    problem: Problem, germ: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> tuple[Array, Array, Array]:
    """The parts of `Reached`."""
    limits = worst_case_limits(problem)
    functionals = functionals_of(tuple(one.expression for one in limits))
    times, step = grid_at(problem, decisions).times, step_at(problem, decisions)
    numbers = named_numbers(problem.simulation, decisions)

    def one(values: tuple[Array, ...]) -> tuple[Array, Array, Array]:
        scope = OneSystem(dict(zip(functionals, values, strict=True)), numbers, step)
        found = []
        for limit in limits:
            value = jnp.asarray(limit.expression.evaluate(scope))
            beyond = jnp.ravel(jnp.maximum(value - limit.upper, limit.lower - value))
            # The first NaN counts as the largest.
            worst = jnp.argmax(beyond)
            time = times[worst * len(times) // beyond.size] if limit.is_path else jnp.nan
            found.append((beyond[worst], jnp.ravel(value)[worst], time))
        return tuple(jnp.stack(part) for part in zip(*found, strict=True))  # type: ignore[return-value]

    return jax.vmap(one)(responses(problem, functionals, germ, decisions))


REACHED = Compiled(_reached)


@final
class Oracle:
    """The model of a problem at realisations, in batches, on a grid with `factor` times as many steps as its own.

    `asked`: the number of realisations that were simulated.
    """

    def __init__(self, problem: Problem, factor: int):
        self._traced = numbers_to_arrays(problem.on_grid(problem.grid.finer(factor)))
        self.low, self.high = germ_box(problem).T
        self.asked = 0

    def __call__(self, germ: Float[np.ndarray, "points variables"], decisions: np.ndarray) -> Reached:
        self.asked += len(germ)
        return Reached(*in_batches(REACHED, self._traced, germ, jnp.asarray(decisions)))

    def germ(self, points: Points) -> Float[np.ndarray, "points variables"]:
        """Map points of the unit box into the germ's box."""
        return self.low + points * (self.high - self.low)

    def unit(self, germ: Float[np.ndarray, "points variables"]) -> Points:
        """The inverse of `germ`."""
        return (germ - self.low) / (self.high - self.low)
