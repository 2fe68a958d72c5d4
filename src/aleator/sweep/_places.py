"""Places on a front: even ones between all wishes, and the gaps between two."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Points that are nearer to one another, as a part of their range, are the same place.
_APART = 1e-3


class Gap(NamedTuple):
    """A gap of a front of two wishes: its places between the anchors, from 0 to 1, and the points at its ends."""

    first: float
    last: float
    before: Float[np.ndarray, " wishes"]
    after: Float[np.ndarray, " wishes"]

    @property
    def width(self) -> float:
        """Its part of the line between the anchors."""
        return self.last - self.first

    @property
    def ends(self) -> tuple[float, float]:
        """The first wish at its ends."""
        return float(self.before[0]), float(self.after[0])

    def size(self, scales: Float[np.ndarray, " wishes"]) -> float:
        """The largest difference of its ends, in scaled wishes; lines through a hole end at one of its ends."""
        return float(np.abs((self.after - self.before) * scales).max())


def simplex(size: int, count: int) -> list[Float[np.ndarray, " wishes"]]:
    """So many points spread evenly over the inside and the edges of a simplex, without its corners."""
    parts = 1
    while len(inner := _lattice(size, parts)) < count:
        parts += 1
    return inner if len(inner) == count else [inner[i] for i in sorted(far_apart(np.array(inner), count))]


def box(size: int, parts: int) -> list[Float[np.ndarray, " wishes"]]:
    """Starts of parallel lines that pass evenly through a unit box in the direction of its diagonal.

    They are the points of a lattice on the plane through the box's middle whose line meets it, for fronts of which no
    simplex between the best designs is known.
    """
    shifted = ((size - 1) * (one - 1 / size) + 0.5 for one in _lattice(size, parts))
    return [one for one in shifted if np.ptp(one) < 1.0]


def far_apart(values: Float[np.ndarray, "k wishes"], count: int, taken: int = 0) -> list[int]:
    """The indices of at most so many points, each as far as can be from those before and from the first few, which are
    taken already.
    """
    if len(values) <= taken:
        return []
    spread = np.ptp(values, axis=0)
    scaled = values / np.where(spread > 0, spread, 1.0)
    chosen = list(range(taken)) or [int(np.argmin(scaled[:, 0]))]
    while len(chosen) < min(count + taken, len(values)):
        away = np.abs(scaled[:, None] - scaled[chosen][None]).max(axis=2).min(axis=1)
        if not away.max() > _APART:
            break
        chosen.append(int(np.argmax(away)))
    return chosen[taken:]


def _lattice(size: int, parts: int) -> list[Float[np.ndarray, " wishes"]]:
    """All sums of multiples of `1 / parts` that make one, but for the corners (Das and Dennis 1998)."""
    bars = combinations(range(parts + size - 1), size - 1)
    every = (np.diff([-1, *one, parts + size - 1]) - 1 for one in bars)
    return [one / parts for one in every if one.max() < parts]
