"""Places on a front: even ones between all wishes, and the gaps between two."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


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

    def size(self, scales: Float[np.ndarray, " wishes"]) -> float:
        """The largest difference of its ends, in scaled wishes; lines through a hole end at one of its ends."""
        return float(np.abs((self.after - self.before) * scales).max())


def simplex(size: int, count: int) -> list[Float[np.ndarray, " wishes"]]:
    """About `count` points spread evenly over the inside and the edges of a simplex, without its corners."""
    parts = 1
    while len(inner := _lattice(size, parts)) < count:
        parts += 1
    return inner


def _lattice(size: int, parts: int) -> list[Float[np.ndarray, " wishes"]]:
    """All sums of multiples of `1 / parts` that make one, but for the corners (Das and Dennis 1998)."""
    bars = combinations(range(parts + size - 1), size - 1)
    every = (np.diff([-1, *one, parts + size - 1]) - 1 for one in bars)
    return [one / parts for one in every if one.max() < parts]
