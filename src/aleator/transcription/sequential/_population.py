"""The values of a problem at many decisions in few calls, on all cores, without derivatives."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, functionals_of, refuse_changed_code
from aleator.ensemble import Part, each, fill, parts
from aleator.expansion import Collocation
from aleator.statistics import Constants
from aleator.transcription._scope import scope_of

# Systems simulated together: more are slower, because their histories leave the cache.
_SYSTEMS = 128

# Calls by one thread before it waits for the others, which takes time.
_CALLS = 8


def _values(
    problem: Problem, collocation: Collocation, constants: Constants, several: Float[Array, "k n"]
) -> Float[Array, "k rows"]:
    functionals = functionals_of(problem.expressions)

    def one(decisions: Float[Array, " n"]) -> Float[Array, " rows"]:
        scope = scope_of(problem, functionals, collocation, constants, decisions)
        values, _ = scope.evaluated(problem.expressions)
        finite = jnp.array([jnp.isfinite(samples).all() for samples in scope.samples.values()]).all()
        # A statistic may hide a failed simulation: the probability of a rare event is zero if that system gives NaN.
        return jnp.where(finite, jnp.concatenate(values), jnp.nan)

    return jax.vmap(one)(several)


def _use(problem: Problem, *_: Any) -> Use:
    return Use.LOOPS if problem.is_integrated else Use.ROWS


VALUES = Compiled(_values, use=_use, unchanged=refuse_changed_code)


@final
class Population:
    """The objective and the rows of the constraints at any number of decisions.

    Compiled for one design and for as many as are worth one call.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants):
        self._together = max(1, _SYSTEMS // len(collocation.points))
        self._of_size = {size: VALUES.bound(traced, collocation, constants) for size in {1, self._together}}

    def __call__(self, decisions: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        """The objectives, shape (k,), and the rows of the constraints, shape (k, rows)."""
        size = self._together if len(decisions) > 1 else 1
        program = self._of_size[size]
        # Traced here, because only the calling thread may run a user's code.
        program.prepare(fill(decisions[:size], size))

        def values(part: Part) -> Float[np.ndarray, "some rows"]:
            some = [np.asarray(program(fill(one.points, size))) for one in parts(part.points, size)]
            return np.concatenate(some)[: len(part.points)]

        rows = np.concatenate([found for _, found in each(values, parts(decisions, size * _CALLS))])
        return rows[:, 0], rows[:, 1:]
