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
# Places at which the model is evaluated at once beside its blocks.
_PLACES = 256


def known_numbers(pointwise: Pointwise, places: Any, decisions: Float[Array, " n"]) -> Float[Array, " known"]:
    """The signals at some places, one by one, then the duration, unless each realisation has its own."""
    return jnp.append(pointwise.known(places, decisions).ravel(), pointwise.duration(decisions))


def are_affine(pointwise: Pointwise, mesh: Mesh) -> bool:
    """Whether the derivatives of signals and duration are the same at all decisions: no equation of theirs needs these
    any more.
    """
    one = np.zeros(pointwise.problem.placements.size)
    told = partial(known_numbers, pointwise, mesh.places)
    closed = jax.make_jaxpr(lambda x, along: jax.jvp(told, (x,), (along,))[1])(one, one)
    _, is_needed = dce_jaxpr(closed.jaxpr, [True])
    return not is_needed[0]


def _told(
    source: tuple[Problem, str],
    at: tuple[Float[Array, "places 2"], Float[Array, " n"], Float[Array, "directions n"]],
) -> Float[Array, "rows known"]:
    """What `known_numbers` gives in a phase; below, its derivatives along some directions."""
    places, decisions, directions = at
    pointwise = Pointwise.of(*source)
    values, along = jax.linearize(lambda x: known_numbers(pointwise, places, x), decisions)
    return jnp.concatenate([values[None], jax.vmap(along)(directions)])


TOLD = Compiled(_told, use=Use.ONCE)


def in_chunks(places: Float[np.ndarray, "places ..."]) -> list[tuple[np.ndarray, int]]:
    """The numbers of places, as many at once on every mesh, and how many of them are not told twice."""
    firsts = range(0, len(places), _PLACES)
    return [
        (np.minimum(np.arange(first, first + _PLACES), len(places) - 1), min(_PLACES, len(places) - first))
        for first in firsts
    ]


def _told_at(
    source: tuple[Problem, str], places: Float[np.ndarray, "places 2"], decisions: np.ndarray, directions: np.ndarray
) -> tuple[Float[np.ndarray, "rows signals"], Float[np.ndarray, "rows durations"]]:
    """See `_told`, for any number of places: the signals, and the duration."""
    chunks = in_chunks(places)
    told = [np.asarray(TOLD(source, (places[which], decisions, directions))) for which, _ in chunks]
    signals = told[0].shape[1] // _PLACES
    parts = [rows[:, : count * signals] for rows, (_, count) in zip(told, chunks, strict=True)]
    return np.concatenate(parts, axis=1), told[0][:, signals * _PLACES :]


def signals_at(
    traced: Problem, phase: str, places: Float[np.ndarray, "places 2"], decisions: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "places signals"]:
    """The signals of a phase at some places of its duration."""
    nowhere = np.zeros((min(_AT_ONCE, decisions.size), decisions.size))
    return _told_at((traced, phase), places, decisions, nowhere)[0][0].reshape(len(places), -1)


def affine_signals(traced: Problem, layout: Layout) -> tuple[Float[np.ndarray, " known"], SparseMatrix]:
    """What is `Layout.known` of the decisions, at zero decisions, and its derivatives by them.

    Where it is not affine no numbers, and no derivatives.
    """
    (decisions,), known = layout.sizes.decisions, layout.known.size
    if not layout.plan.is_affine:
        return np.zeros(0), scipy.sparse.csr_array((known, decisions))
    constants, every = [], []
    for phase in layout.phases:
        constant, slopes = np.zeros(0), []
        for first in range(0, decisions, _AT_ONCE):
            directions = np.eye(min(_AT_ONCE, decisions), decisions, first)
            told = _told_at((traced, phase.name), phase.mesh.places, np.zeros(decisions), directions)
            constant, *along = np.concatenate(told, axis=1)
            slopes.append(scipy.sparse.csr_array(np.stack(along[: decisions - first], axis=1)))
        constants.append(constant)
        every.append(scipy.sparse.hstack(slopes, format="csr"))
    return np.concatenate(constants), scipy.sparse.vstack(every, format="csr")
