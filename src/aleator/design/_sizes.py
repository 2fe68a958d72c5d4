"""The magnitudes behind functionals, which determine what counts as rounding."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design._declaration import AbstractProblem
from aleator.design._functionals import Integral
from aleator.design._response import grid_at, history
from aleator.design._statistic import functionals_of


def sizes(
    problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]
) -> tuple[Float[Array, ""], ...]:
    """The magnitude behind each functional on one realisation: the largest of its output over time.

    For example, the rate at the end of a motion that comes to rest is small only by cancellation.
    """
    return _SIZES(numbers_to_arrays(problem), germ, decisions)


def _sizes(
    problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]
) -> tuple[Float[Array, ""], ...]:
    outputs, times = history(problem, germ, decisions), grid_at(problem, decisions).times
    duration = times[-1] - times[0]
    return tuple(
        jnp.max(jnp.abs(outputs[one.output])) * (duration if isinstance(one, Integral) else 1.0)
        for one in functionals_of(problem.expressions)
    )


_SIZES = Compiled(_sizes, use=Use.ONCE)
