"""`Mesh`: intervals of the duration, and a scheme's points in them."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from aleator.dynamics import AbstractScheme


@final
@dataclass(frozen=True)
class Mesh:
    """Intervals of the duration, and the points of a scheme in them. Ends of intervals are shared.

    - `nodes`: the ends of the intervals, as fractions of the duration; every instant of the grid is one of them.
    """

    nodes: tuple[float, ...]
    scheme: AbstractScheme

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
        """The numbers of the points at which rates are asked, each once, in ascending order."""
        return np.unique(self.points[:, self.scheme.asked])

    @property
    def stages(self) -> Int[np.ndarray, "intervals stages"]:
        """Which of the points `asked` the stages of each interval are."""
        return np.searchsorted(self.asked, self.points[:, self.scheme.asked])

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
        return Mesh((*np.concatenate(inside).tolist(), self.nodes[-1]), self.scheme)

    def instants(self, fractions: Float[np.ndarray, " instants"]) -> Int[np.ndarray, " instants"]:
        """The numbers of the points that the instants of a grid are."""
        nearest = np.abs(np.array(self.nodes) - np.asarray(fractions)[:, None]).argmin(axis=1)
        return nearest * (len(self.scheme.points) - 1)
