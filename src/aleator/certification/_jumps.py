"""Jumps of outputs at the knots of trajectories, such as torques of a motion of degree 2: both sides of them.

An instant has the value of one side of a jump only, so that the sides before and after it are judged separately.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import Problem
from aleator.trajectories import BSpline, piecewise_in
from aleator.uncertainty import at_means, realise

# A jump exceeds this many changes between neighbouring fine instants, and this part of the values.
_STEEP, _LEAST = 5.0, 1e-6
# A knot within this many steps of an instant coincides with it up to rounding.
_AT = 1e-6


class Jump(NamedTuple):
    """One jump of a path: its place in steps of the finer grid, and the values on both sides, shape (entries,)."""

    place: float
    before: Float[np.ndarray, " entries"]
    after: Float[np.ndarray, " entries"]


def splines_in(tree: Any) -> list[BSpline]:
    """All splines in a model or a part of it, including those inside other trajectories."""

    def is_spline(node: Any) -> bool:
        return isinstance(node, BSpline)

    return [one for one in jax.tree.leaves(tree, is_leaf=is_spline) if is_spline(one)]


def knots(problem: Problem, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " knots"]:
    """The interior knots of splines and nodes of controls at some decisions, as fractions of a problem's time."""
    model = realise(at_means(problem.simulation), jnp.zeros(0), jnp.asarray(decisions))
    parts = model.system, model.inputs
    ends = (one.breaks() for one in (*splines_in(parts), *piecewise_in(parts)))
    found = np.concatenate([np.zeros(0), *ends])
    return np.unique(found[(found > 0) & (found < 1)])


def jumps(values: Float[np.ndarray, "finer entries"], at: Float[np.ndarray, " knots"]) -> list[Jump]:
    """The jumps of a path at knots, from linear extrapolation on both sides."""
    found = []
    last, size = len(values) - 1, float(np.abs(values).max(initial=0.0))
    for place in at * last:
        left, right = int(np.ceil(place - _AT)) - 1, int(np.floor(place + _AT)) + 1
        if left < 1 or right > last - 1:
            continue
        rising, going = values[left] - values[left - 1], values[right + 1] - values[right]
        before, after = values[left] + rising * (place - left), values[right] - going * (right - place)
        change = max(float(np.abs(rising).max()), float(np.abs(going).max()))
        if float(np.abs(after - before).max()) > _STEEP * change + _LEAST * size:
            found.append(Jump(float(place), before, after))
    return found


def one_sided(
    first: Float[np.ndarray, " intervals"],
    last: Float[np.ndarray, " intervals"],
    inside: Float[np.ndarray, "intervals fine"],
    found: list[tuple[float, float, float]],
) -> None:
    """Let each end of an interval with a jump account for its own side only; changes `first` and `last` in place.

    - `first`, `last`: the shifts required at the left and right ends of intervals; `inside`: the excess at fine
      instants;
    - `found`: jumps, as place in fine steps and excess before and after.
    """
    factor = inside.shape[1] - 1
    for i in sorted({j for place, _, _ in found for j in _intervals(place / factor, len(inside))}):
        here = [(place / factor - i, before, after) for place, before, after in found]
        here = [one for one in here if -_AT <= one[0] <= 1 + _AT]
        fine = np.arange(factor + 1) / factor
        earliest, latest = min(one[0] for one in here), max(one[0] for one in here)
        # Exactly at a jump, rounding decides which side an instant's value belongs to.
        left = inside[i][fine < earliest - _AT].tolist() + [before for at, before, _ in here if at == earliest]
        right = inside[i][fine > latest + _AT].tolist() + [after for at, _, after in here if at == latest]
        first[i] = max(left) if earliest > _AT else -np.inf
        last[i] = max(right) if latest < 1 - _AT else -np.inf


def _intervals(place: float, count: int) -> set[int]:
    """The intervals that contain a place, in steps: two if it is an instant."""
    return {i for i in (int(np.floor(place - _AT)), int(np.floor(place + _AT))) if 0 <= i < count}
