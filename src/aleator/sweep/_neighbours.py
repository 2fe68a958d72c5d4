"""Which points of a front a neighbour's design may better: those whose optimum does not move as its price says."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

# Objectives with a smaller difference, as a part of the largest on the front, are the same: solvers leave that much.
SAME = 1e-6
# By so much of the steeper of two prices, times the step between them, an optimum may be above what both say: a front
# is a smooth curve, along which the mean of two slopes is off by a twelfth of its third derivative.
_OFF = 0.05


class Place(NamedTuple):
    """A point of a front: its bound, its optimum, and the slope of that by the bound; NaN where there is none."""

    bound: float
    objective: float
    slope: float

    @property
    def is_solved(self) -> bool:
        """Whether there is an optimum."""
        return not np.isnan(self.objective)


def doubtful(places: Sequence[Place], relaxing: int, size: float) -> Iterator[tuple[float, float]]:
    """The bounds of points that the design of a solved neighbour may better, each with the bound of this neighbour.

    These are points without an optimum, those worse than a tighter neighbour, whose design is theirs too, and those
    worse than the neighbour's optimum, moved by the mean of both slopes. `relaxing`: 1 if a larger bound is a weaker
    one, -1 if a smaller one is, 0 if neither; `size`: the largest objective on the front.
    """
    ordered = sorted(places)
    for i, place in enumerate(ordered):
        for side in (ordered[:i][::-1], ordered[i + 1 :]):
            neighbour = next((one for one in side if one.is_solved), None)
            if neighbour is not None and _is_doubtful(place, neighbour, relaxing, size):
                yield place.bound, neighbour.bound


def _is_doubtful(place: Place, neighbour: Place, relaxing: int, size: float) -> bool:
    if not place.is_solved:
        return True
    step, risen = place.bound - neighbour.bound, place.objective - neighbour.objective
    if step * relaxing > 0 and risen > SAME * size:
        return True
    steeper = max(abs(place.slope), abs(neighbour.slope))
    return risen - step * (place.slope + neighbour.slope) / 2 > _OFF * abs(step) * steeper + SAME * size
