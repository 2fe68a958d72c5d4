"""Typical magnitudes of the variables of a simultaneous program: a solver scales, and violations are judged, by them.

They are those of the point itself, not of a start that may be wild. What is zero there has the magnitude that typical
changes of what it is tied to would give it.
"""

import jax
import numpy as np
from jaxtyping import Float

from aleator.nlp import Evaluation
from aleator.transcription.simultaneous._assembly import Ties
from aleator.transcription.simultaneous._layout import Layout

# A magnitude below this is rounding.
_NOTHING = 1e-12
# Along a chain of so many states, each the rate of the next, forces reach a state that is zero.
_CHAIN = 4
# For such a part of the time: all the way, a push of typical magnitude would turn and carry most things beyond reason.
_PUSHED = 0.1


def scales(
    layout: Layout,
    ties: Ties,
    point: Float[np.ndarray, " variables"],
    evaluation: Evaluation,
    decisions: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " variables"]:
    """A typical magnitude of each variable: the largest of its kind, or what it would be if all that it is tied to
    changed by a typical magnitude.

    - `decisions`: typical magnitudes of the decisions.
    """
    numbers, slopes = layout.numbers, abs(evaluation.jacobian[ties.rows])
    scale = _by_kind(layout, np.abs(point))
    scale[numbers.decisions] = decisions
    signals, *later = layout.stages
    scale = _reached(layout, ties, slopes, scale, signals)
    for phase, own in zip(layout.phases, numbers.phases, strict=True):
        intervals = _PUSHED * len(phase.mesh.lengths)
        for _ in range(_CHAIN):
            still = own.states[scale[own.states] <= _NOTHING]
            if not still.size:
                break
            scale = _reached(layout, ties, intervals * slopes, scale, still)
        still = own.integrals[scale[own.integrals] <= _NOTHING]
        scale = _reached(layout, ties, intervals * slopes, scale, still)
    for some in later:
        scale = _reached(layout, ties, slopes, scale, some)
    return np.where(scale > _NOTHING, scale, 1.0)


def tie_sizes(
    layout: Layout, ties: Ties, evaluation: Evaluation, scale: Float[np.ndarray, " variables"]
) -> Float[np.ndarray, " ties"]:
    """A typical magnitude of each tie: that of the variable that stands in it; of an equation of algebraic variables,
    or of an event, which has a unit of its own, what it would change by if all of these, or the states, changed by
    theirs.
    """
    sizes = scale[ties.variables]
    for phase, own in zip(layout.phases, layout.numbers.phases, strict=True):
        ended = own.duration[:, : int(phase.pointwise.is_open)]
        for solved, moved in ((own.algebraic, own.algebraic), (ended, own.states)):
            equations, moving = np.isin(ties.variables, solved), np.zeros_like(scale)
            moving[moved] = scale[moved]
            change = abs(evaluation.jacobian[ties.rows[equations]]) @ moving
            sizes[equations] = np.where(np.isfinite(change) & (change > 0), change, 1.0)
    return sizes


def _reached(
    layout: Layout, ties: Ties, slopes: np.ndarray, scale: Float[np.ndarray, " variables"], which: np.ndarray
) -> Float[np.ndarray, " variables"]:
    """Magnitudes, those of some variables being no less than what they are tied to may change them by."""
    change, these = slopes @ scale, np.isin(ties.variables, which)
    own = ties.variables[these]
    larger = scale.copy()
    larger[own] = np.maximum(scale[own], np.nan_to_num(change[these] - scale[own], posinf=0.0))
    return np.where(np.isin(np.arange(layout.count), which), _by_kind(layout, larger), scale)


def _by_kind(layout: Layout, sizes: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " variables"]:
    """The largest of each kind of variables: one state at all points, one output at all instants."""

    def largest(part: np.ndarray, keep: int) -> np.ndarray:
        over = tuple(range(part.ndim - keep))
        finite = np.where(np.isfinite(part), part, 0.0)
        return np.broadcast_to(finite.max(axis=over, initial=0.0), part.shape)

    result, values = np.zeros(layout.count), layout.view(sizes)
    each = jax.tree.map(lambda one: largest(one, 1), values._replace(coefficients=[]))
    each = each._replace(coefficients=[largest(one, 0) for one in values.coefficients])
    for where, scale in zip(jax.tree.leaves(layout.numbers), jax.tree.leaves(each), strict=True):
        result[where] = scale
    return result
