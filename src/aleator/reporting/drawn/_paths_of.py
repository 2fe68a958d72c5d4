"""The outputs of a design: which there are by name, and their histories on simulated systems."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import (
    AbstractFunctional,
    Problem,
    history,
    path,
    responses,
)
from aleator.ensemble import draw
from aleator.solution import Solution


def _respond(
    problem: Problem, functional: AbstractFunctional, germ: Float[jax.Array, "systems variables"], decisions: jax.Array
) -> Float[jax.Array, "systems instants ..."]:
    return responses(problem, (functional,), germ, decisions)[0]


_RESPOND = Compiled(_respond)


def simulated(solution: Solution, output: str, samples: int, seed: int) -> Float[np.ndarray, "systems instants ..."]:
    """An output of random systems at the decisions of a solution; of the one system where nothing is uncertain.

    Raises `ProblemError` if the code of the system has changed, and `SimulationError` for what is not finite.
    """
    problem = solution.problem
    germs = tuple(problem.placements.germs.values())
    points = draw(germs, samples, np.random.default_rng(seed)) if germs else np.zeros((1, 0))
    found = _RESPOND(numbers_to_arrays(problem), path(output), jnp.asarray(points), jnp.asarray(solution.vector))
    values = np.asarray(found)
    if not np.isfinite(values).all():
        raise SimulationError(
            f"plot.histories: expected finite numbers; '{output}' is not finite on some systems: see al.validate."
        )
    return values


def outputs_of(problem: Problem, solution: Solution) -> Mapping[str, str]:
    """The outputs of a system, by name. Raises `ProblemError` for a system without time."""
    if not problem.system.has_time:
        raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
    germ = jnp.zeros(len(problem.placements.germs))
    return dict.fromkeys(jax.eval_shape(lambda: history(problem, germ, jnp.asarray(solution.vector))), "")
