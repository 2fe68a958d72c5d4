"""`Mesh`: intervals of the duration, and a scheme's points in them."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int, Num

from aleator.dynamics import AbstractScheme


@final
@dataclass(frozen=True)
class Mesh:
    """Intervals of the duration, and the points of a scheme in them. Ends of intervals are shared.

    - `nodes`: the ends of the intervals, as fractions of the duration; every instant of the grid is one of them;
    - `has_jumps`: whether signals may jump at the nodes. They then have two values there, one for each interval, at
      `places` of their own, and rates are asked of each.
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
        """The numbers of the points where blocks begin, in ascending order: each once, if nothing jumps there."""
        return self.points[:, self.scheme.asked].ravel()[self._once]

    @property
    def stages(self) -> Int[np.ndarray, "intervals stages"]:
        """Which of the points `asked` the blocks of each interval begin at."""
        every = self.points[:, self.scheme.asked]
        return np.arange(every.size).reshape(every.shape) if self.has_jumps else np.searchsorted(self.asked, every)

    @property
    def places(self) -> Float[np.ndarray, "places 2"]:
        """Where signals are told: fractions of the duration, each with 1 for signals as they are before a jump there,
        else 0. Nodes are told once, or where signals jump for each interval.
        """
        nodes = np.array(self.nodes)
        inside = nodes[:-1, None] + self.lengths[:, None] * self.scheme.told[:-1]
        every = np.stack(np.broadcast_arrays(np.append(inside, nodes[1:, None], axis=1), 0.0), axis=2)
        every[:, -1, 1] = self.has_jumps
        return self._told(every)

    @property
    def sides(self) -> Int[np.ndarray, " places"]:
        """The number of the point that each of the `places` is at, or after."""
        return self._told(self.points[:, np.searchsorted(self.scheme.points, self.scheme.told, side="right") - 1])

    @property
    def asked_sides(self) -> Int[np.ndarray, "asked seen"]:
        """Which of the `places` each block depends on."""
        seen = self.scheme.seen
        return self._sides[:, seen].reshape(-1, seen.shape[1])[self._once]

    @property
    def weights(self) -> Float[np.ndarray, " places"]:
        """The scheme's quadrature over the whole duration, for a duration of one."""
        found = np.zeros(len(self.places))
        np.add.at(found, self._sides, self.lengths[:, None] * self.scheme.quadrature)
        return found

    @property
    def weighed(self) -> Int[np.ndarray, " weighed"]:
        """Which of the `places` this quadrature has."""
        return np.flatnonzero(self.weights)

    def refined(self, scheme: AbstractScheme, parts: Int[np.ndarray, " intervals"]) -> "Mesh":
        """The mesh with each interval in so many equal parts, and a scheme in each of these."""
        ends = zip(self.nodes[:-1], self.nodes[1:], parts, strict=True)
        inside = [np.linspace(first, last, count + 1)[:-1] for first, last, count in ends]
        return Mesh((*np.concatenate(inside).tolist(), self.nodes[-1]), scheme, self.has_jumps)

    def instants(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """The numbers of the points that the instants of a grid are."""
        return self._nearest(fractions) * (len(self.scheme.points) - 1)

    def instant_sides(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """Which of the `places` are those of these points: at a jump, that of the interval which begins."""
        return np.append(self._sides[:, 0], self._sides[-1, -1])[self._nearest(fractions)]

    @property
    def _sides(self) -> Int[np.ndarray, "intervals told"]:
        """The numbers of each interval's places among all."""
        count = len(self.scheme.told)
        apart = count if self.has_jumps else count - 1
        return np.arange(len(self.lengths))[:, None] * apart + np.arange(count)

    def _told(self, every: Num[np.ndarray, "intervals told ..."]) -> Num[np.ndarray, "places ..."]:
        """What belongs to the places of each interval, by place."""
        found = np.zeros((self._sides[-1, -1] + 1, *every.shape[2:]), dtype=every.dtype)
        found[self._sides] = every
        return found

    @property
    def _once(self) -> Int[np.ndarray, " asked"]:
        """Which of all intervals' blocks there are: of two that begin at the same point one, if nothing jumps there."""
        every = self.points[:, self.scheme.asked].ravel()
        return np.arange(every.size) if self.has_jumps else np.unique(every, return_index=True)[1]

    def _nearest(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        return np.abs(np.array(self.nodes) - np.asarray(fractions)[:, None]).argmin(axis=1)
