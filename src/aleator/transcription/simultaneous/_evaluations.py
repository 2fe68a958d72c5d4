"""What follows from a phase at given places of its duration, beside the blocks of a program: signals and durations from
decisions, algebraic variables, and levels of the event that ends it.

Signals are nearly always affine in the decisions, as splines are in their control points: at an instant each depends on
few decisions, by constant derivatives. So long signals stay sparse. Whether they are affine follows from the traced
equations, never from values.
"""

from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import eval_jaxpr
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator._core.dependence import interpreted
from aleator.design import Problem
from aleator.nlp import SparseMatrix
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Decisions by which signals are differentiated at once: all of them would take a dense matrix.
_AT_ONCE = 64
# Places that are evaluated at once, as many on every mesh.
_PLACES = 256
# A level that is a smaller part of the largest is zero.
_ROUNDING = 1e-9

Source = tuple[Problem, str]
"""A problem with its numbers as arrays, and the name of a phase."""


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


def _evaluated(what: str, source: Source, points: Array, places: Array, at: tuple[Array, ...]) -> Array:
    """See `evaluated_at`."""
    pointwise, (model, duration, signals, states) = Pointwise.of(*source), at
    shared = model if pointwise.is_open else jnp.append(model, duration)

    def one(germ: Array, own: Array, place: Array, signal: Array, state: Array) -> Array:
        return getattr(pointwise, what)(germ, place, shared, jnp.concatenate([signal, own, state]))

    inner = jax.vmap(one, in_axes=(None, None, 0, 0, 0))
    durations = duration if pointwise.is_open else jnp.zeros((len(points), 0))
    return jax.vmap(inner, in_axes=(0, 0, None, None, 0))(points, durations, places, signals, states)


EVALUATED = Compiled(_evaluated, use=Use.ONCE)


def evaluated_at(
    what: Literal["algebraic", "level"],
    source: Source,
    points: Float[np.ndarray, "realisations germs"],
    places: Float[np.ndarray, "places 2"],
    model: Float[np.ndarray, " direct"],
    duration: Float[np.ndarray, "durations 1"],
    signals: Float[np.ndarray, "places signals"],
    states: Float[np.ndarray, "realisations places states"],
) -> Float[np.ndarray, "realisations places numbers"]:
    """Algebraic variables, or the level of the event that ends a phase, at some places of all realisations.

    - `model`: the decisions of the model itself, see `Pointwise.direct`; `duration`: see `PhaseVariables`.
    """
    parts = []
    for first in range(0, len(places), _PLACES):
        which = np.minimum(np.arange(first, first + _PLACES), len(places) - 1)
        at = model, duration, signals[which], states[:, which]
        every = np.asarray(EVALUATED(what, source, points, places[which], at))
        parts.append(every[:, : len(places) - first])
    return np.concatenate(parts, axis=1)


def first_crossing(
    levels: Float[np.ndarray, " places"], fractions: Float[np.ndarray, " places"], direction: int
) -> float | None:
    """Where levels first cross zero, in a direction that counts, by straight lines; None if they do not.

    A start at zero, up to rounding, is no crossing.
    """
    levels = np.where(np.abs(levels) <= _ROUNDING * np.abs(levels).max(), 0.0, levels)
    rises, falls = ((side * levels[:-1] < 0) & (side * levels[1:] >= 0) for side in (1, -1))
    crosses = {1: rises, -1: falls, 0: rises | falls}[direction]
    if not crosses.any():
        return None
    k = int(np.argmax(crosses))
    return float(fractions[k] + levels[k] / (levels[k] - levels[k + 1]) * (fractions[k + 1] - fractions[k]))
