"""How signals depend on decisions: nearly always in an affine way, such as splines on their control points.

Each signal then depends at an instant on few decisions, which numbers tell exactly: the derivatives are constant. So
long signals stay sparse. Whether they are affine follows from the traced equations, never from values.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.nlp import SparseMatrix
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Decisions by which signals are differentiated at once: all of them would take a dense matrix.
_AT_ONCE = 64


def known_numbers(asked: Pointwise, mesh: Mesh, decisions: Float[Array, " n"]) -> Float[Array, " known"]:
    """The signals at all places of a mesh, one by one, then the duration."""
    fractions, is_before = mesh.places.T
    signals = asked.known(fractions, decisions, is_before > 0)
    return jnp.append(signals.ravel(), asked.duration(decisions))


def are_affine(asked: Pointwise, mesh: Mesh) -> bool:
    """Whether the derivatives of signals and duration are the same at all decisions: no equation of theirs needs these
    any more.
    """
    one = jnp.zeros(asked.problem.placements.size)
    closed = jax.make_jaxpr(lambda x, along: jax.jvp(lambda at: known_numbers(asked, mesh, at), (x,), (along,))[1])(
        one, one
    )
    _, is_needed = dce_jaxpr(closed.jaxpr, [True])
    return not is_needed[0]


def _along(problem: Problem, mesh: Mesh, directions: Float[Array, "some n"]) -> Float[Array, "some known"]:
    asked = Pointwise.of(problem)

    def change(direction: Array) -> Array:
        return jax.jvp(lambda at: known_numbers(asked, mesh, at), (jnp.zeros_like(direction),), (direction,))[1]

    return jax.vmap(change)(directions)


ALONG = Compiled(_along, use=Use.ONCE)


def constant_slopes(traced: Problem, layout: Layout) -> SparseMatrix:
    """The derivatives of signals and duration by the decisions if they are constant, else nothing.

    Shape (signals at all mesh points and the duration, decisions).
    """
    (decisions,), known = layout.sizes.decisions, layout.numbers.signals.size + 1
    if not layout.plan.is_affine:
        return scipy.sparse.csr_array((known, decisions))
    parts = [scipy.sparse.csr_array((known, 0))]
    for first in range(0, decisions, _AT_ONCE):
        directions = np.eye(_AT_ONCE, decisions, first)
        slopes = np.asarray(ALONG(traced, layout.plan.mesh, directions)).T
        parts.append(scipy.sparse.csr_array(slopes[:, : decisions - first]))
    return scipy.sparse.hstack(parts, format="csr")
