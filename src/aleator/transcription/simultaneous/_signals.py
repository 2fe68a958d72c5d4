"""How signals and durations follow from the decisions: evaluated anywhere, and as matrices where they are affine.

Signals are nearly always affine in the decisions, as splines are in their control points: at an instant each depends on
few decisions, by constant derivatives. So long signals stay sparse. Whether they are affine follows from the traced
equations, never from values.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import eval_jaxpr
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float

from aleator._core.dependence import interpreted
from aleator.nlp import SparseMatrix
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Decisions by which signals are differentiated at once: all of them would take a dense matrix.
_AT_ONCE = 64


def known_numbers(pointwise: Pointwise, places: Any, decisions: Float[Array, " n"]) -> Float[Array, " known"]:
    """The signals at some places, one by one, then the duration, unless each realisation has its own."""
    return jnp.append(pointwise.known(places, decisions).ravel(), pointwise.duration(decisions))


def affine_signals(pointwise: Pointwise, mesh: Mesh) -> tuple[Float[np.ndarray, " known"], SparseMatrix] | None:
    """What `known_numbers` gives for a mesh where all decisions are zero, and its derivatives by these; None unless
    these are the same at all decisions: no equation of theirs needs these any more. Nothing is compiled.
    """
    count = pointwise.problem.placements.size
    told, nothing = partial(known_numbers, pointwise, mesh.places), np.zeros(count)
    closed = jax.make_jaxpr(lambda x, along: jax.jvp(told, (x,), (along,)))(nothing, nothing)
    constant, _ = dce_jaxpr(closed.jaxpr, [True, False], instantiate=True)
    moved, (is_needed, _) = dce_jaxpr(closed.jaxpr, [False, True], instantiate=[False, True])
    if is_needed:
        return None
    directions = np.eye(min(_AT_ONCE, count), count)
    moving = jax.make_jaxpr(jax.vmap(lambda along: eval_jaxpr(moved, closed.consts, along)[0]))(directions)
    slopes = []
    for first in range(0, count, _AT_ONCE):
        directions = np.eye(*directions.shape, first)
        (along,) = interpreted(moving.jaxpr, moving.consts, [directions])
        slopes.append(scipy.sparse.csr_array(along[: count - first].T))
    (constant,) = interpreted(constant, closed.consts, [nothing, nothing])
    return constant, scipy.sparse.hstack(slopes, format="csr")


def signals_at(
    pointwise: Pointwise, places: Float[np.ndarray, "places 2"], decisions: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "places signals"]:
    """The signals of a phase at some places of its duration."""
    closed = jax.make_jaxpr(partial(pointwise.known, places))(decisions)
    return interpreted(closed.jaxpr, closed.consts, [decisions])[0]
