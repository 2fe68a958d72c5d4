"""Exact second derivatives of a problem's Lagrangian by its decisions, where these are few."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import sparse

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, functionals_of
from aleator.expansion import Collocation
from aleator.nlp import Hessian, with_entries
from aleator.statistics import Constants
from aleator.transcription._scope import scope_of


class _At(NamedTuple):
    """Decisions, the weight of the objective, and the multipliers of all rows."""

    decisions: Float[Array, " n"]
    weight: Float[Array, ""]
    multipliers: Float[Array, " m"]


def _curvature(problem: Problem, collocation: Collocation, constants: Constants, at: _At) -> Float[Array, "n n"]:
    """The second derivatives of `weight f + multipliers · c`: forward mode twice, `n²` directions in one simulation."""
    functionals = functionals_of(problem.expressions)

    def lagrangian(decisions: Float[Array, " n"]) -> Float[Array, ""]:
        values, _ = scope_of(problem, functionals, collocation, constants, decisions).evaluated(problem.expressions)
        rows = jnp.concatenate(values)
        return at.weight * rows[0] + at.multipliers @ rows[1:]

    return jax.jacfwd(jax.jacfwd(lagrangian))(at.decisions)


def _use(problem: Problem, *_: Any) -> Use:
    return Use.LOOPS if problem.is_integrated else Use.ROWS


CURVATURE = Compiled(_curvature, use=_use)


def hessian_of(traced: Problem, collocation: Collocation, constants: Constants, size: int) -> Hessian:
    """Second derivatives for solvers of a problem with `size` decisions."""
    evaluate = CURVATURE.bound(traced, collocation, constants)
    rows, columns = np.tril_indices(size)
    triangle = sparse.csr_array((np.ones(rows.size), (rows, columns)), shape=(size, size))

    def lower(x: np.ndarray, weight: float, multipliers: np.ndarray) -> Any:
        found = np.asarray(evaluate(_At(jnp.asarray(x), jnp.asarray(float(weight)), jnp.asarray(multipliers))))
        return with_entries(triangle, found[rows, columns])

    return Hessian(lower, triangle)
