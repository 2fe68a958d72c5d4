"""`Mesh`: intervals of the duration, and a scheme's points in them."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator.dynamics import AbstractScheme


@final
@dataclass(frozen=True)
class Mesh:
    """Intervals of the duration, and the points of a scheme in them. Ends of intervals are shared.

    - `nodes`: the ends of the intervals, as fractions of the duration; every instant of the grid is one of them;
    - `has_jumps`: whether signals may jump at the nodes. They then have two values there, one for each interval, at
      `sides` of their own, and rates are asked of each.
    """

    nodes: tuple[float, ...]
    scheme: AbstractScheme
    has_jumps: bool = False

    @property
    def lengths(self) -> Float[np.ndarray, " intervals"]:
        """The length of each interval, as a fraction of the duration."""
        return np.diff(self.nodes)

    @property
    def points(self) -> Int[np.ndarray, "intervals points"]:
        """The numbers of each interval's points among all."""
        steps = len(self.scheme.points) - 1
        return np.arange(len(self.lengths))[:, None] * steps + np.arange(steps + 1)

    @property
    def fractions(self) -> Float[np.ndarray, " points"]:
        """All points as fractions of the duration."""
        nodes = np.array(self.nodes)
        inside = nodes[:-1, None] + self.lengths[:, None] * self.scheme.points[:-1]
        return np.append(inside.ravel(), nodes[-1])

    @property
    def asked(self) -> Int[np.ndarray, " asked"]:
        """The numbers of the points at which rates are asked, in ascending order: each once, if nothing jumps there."""
        every = self.points[:, self.scheme.asked]
        return every.ravel() if self.has_jumps else np.unique(every)

    @property
    def stages(self) -> Int[np.ndarray, "intervals stages"]:
        """Which of the points `asked` the stages of each interval are."""
        every = self.points[:, self.scheme.asked]
        return np.arange(every.size).reshape(every.shape) if self.has_jumps else np.searchsorted(self.asked, every)

    @property
    def sides(self) -> Int[np.ndarray, " sides"]:
        """The numbers of the points at which signals are told: each once, or where they jump each for each interval."""
        return self.points.ravel() if self.has_jumps else np.arange(len(self.fractions))

    @property
    def is_before(self) -> Bool[np.ndarray, " sides"]:
        """Whether a signal that jumps at one of the `sides` is told as it is before."""
        count = len(self.scheme.points)
        return np.arange(len(self.sides)) % count == count - 1 if self.has_jumps else np.zeros(len(self.sides), bool)

    @property
    def places(self) -> Float[np.ndarray, "sides 2"]:
        """The `sides` as fractions of the duration, each with 1 for signals as they are before a jump there, else 0."""
        return np.stack([self.fractions[self.sides], self.is_before], axis=1)

    @property
    def asked_sides(self) -> Int[np.ndarray, " asked"]:
        """Which of the `sides` are those of the points `asked`."""
        if not self.has_jumps:
            return self.asked
        return np.arange(len(self.sides)).reshape(self.points.shape)[:, self.scheme.asked].ravel()

    @property
    def weights(self) -> Float[np.ndarray, " asked"]:
        """The scheme's quadrature over the whole duration, at the points `asked`, for a duration of one."""
        found = np.zeros(len(self.asked))
        np.add.at(found, self.stages, self.lengths[:, None] * self.scheme.weights[-1])
        return found

    def divided(self, parts: Int[np.ndarray, " intervals"]) -> "Mesh":
        """The mesh with each interval in so many equal parts."""
        ends = zip(self.nodes[:-1], self.nodes[1:], parts, strict=True)
        inside = [np.linspace(first, last, count + 1)[:-1] for first, last, count in ends]
        return Mesh((*np.concatenate(inside).tolist(), self.nodes[-1]), self.scheme, self.has_jumps)

    def instants(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """The numbers of the points that the instants of a grid are."""
        return self._nearest(fractions) * (len(self.scheme.points) - 1)

    def instant_sides(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """Which of the `sides` are those of these points: at a jump, that of the interval which begins."""
        if not self.has_jumps:
            return self.instants(fractions)
        return np.minimum(self._nearest(fractions) * len(self.scheme.points), len(self.sides) - 1)

    def _nearest(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        return np.abs(np.array(self.nodes) - np.asarray(fractions)[:, None]).argmin(axis=1)
