"""The equations of a phase evaluated beside the blocks of a program: algebraic variables, and levels of the event that
ends it.
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.transcription.simultaneous._pointwise import Pointwise

# Places that are evaluated at once, as many on every mesh.
_PLACES = 256
# A level that is a smaller part of the largest is zero.
_ROUNDING = 1e-9

Source = tuple[Problem, str]
"""A problem with its numbers as arrays, and the name of a phase."""


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
