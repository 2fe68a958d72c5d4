"""Typical magnitudes of the variables of a simultaneous program, at a point.

By them a solver scales, and violations are judged: so they are those of the point itself, not of a start that may be
wild. What is zero there has the magnitude that typical changes of what it is tied to would give it.
"""

import jax
import numpy as np
from jaxtyping import Float

from aleator.nlp import Evaluation, Ties
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
    found = _by_kind(layout, np.abs(point))
    found[numbers.decisions] = decisions
    signals, *later = layout.stages
    found = _reached(layout, ties, slopes, found, signals)
    intervals = _PUSHED * len(layout.plan.mesh.lengths)
    for _ in range(_CHAIN):
        still = numbers.states[found[numbers.states] <= _NOTHING]
        if not still.size:
            break
        found = _reached(layout, ties, intervals * slopes, found, still)
    still = numbers.integrals[found[numbers.integrals] <= _NOTHING]
    found = _reached(layout, ties, intervals * slopes, found, still)
    for some in later:
        found = _reached(layout, ties, slopes, found, some)
    return np.where(found > _NOTHING, found, 1.0)


def tie_sizes(
    layout: Layout, ties: Ties, evaluation: Evaluation, found: Float[np.ndarray, " variables"]
) -> Float[np.ndarray, " ties"]:
    """A typical magnitude of each tie: that of the variable that stands in it; of an equation of algebraic variables,
    which has a unit of its own, what it would change by if all of these changed by theirs.
    """
    sizes, algebraic = found[ties.variables], layout.numbers.algebraic.ravel()
    equations = np.isin(ties.variables, algebraic)
    moving = np.zeros_like(found)
    moving[algebraic] = found[algebraic]
    change = abs(evaluation.jacobian[ties.rows[equations]]) @ moving
    sizes[equations] = np.where(np.isfinite(change) & (change > 0), change, 1.0)
    return sizes


def _reached(
    layout: Layout, ties: Ties, slopes: np.ndarray, found: Float[np.ndarray, " variables"], which: np.ndarray
) -> Float[np.ndarray, " variables"]:
    """Magnitudes, those of some variables being no less than what they are tied to may change them by."""
    change, these = slopes @ found, np.isin(ties.variables, which)
    own = ties.variables[these]
    larger = found.copy()
    larger[own] = np.maximum(found[own], np.nan_to_num(change[these] - found[own], posinf=0.0))
    return np.where(np.isin(np.arange(layout.count), which), _by_kind(layout, larger), found)


def _by_kind(layout: Layout, sizes: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " variables"]:
    """The largest of each kind of variables: one state at all points, one output at all instants."""

    def largest(part: np.ndarray, keep: int) -> np.ndarray:
        over = tuple(range(part.ndim - keep))
        finite = np.where(np.isfinite(part), part, 0.0)
        return np.broadcast_to(finite.max(axis=over, initial=0.0), part.shape)

    found, values = np.zeros(layout.count), layout.view(sizes)
    each = jax.tree.map(lambda one: largest(one, 1), values._replace(coefficients=(), between=()))
    coefficients, between = (tuple(largest(one, 0) for one in some) for some in (values.coefficients, values.between))
    each = each._replace(coefficients=coefficients, between=between)
    for where, scale in zip(jax.tree.leaves(layout.numbers), jax.tree.leaves(each), strict=True):
        found[where] = scale
    return found
