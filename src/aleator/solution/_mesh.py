"""`MeshError`: how well the states of a simultaneous program follow their equations on one mesh."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float


@final
@dataclass(frozen=True)
class MeshError:
    """The error of one mesh, interval by interval.

    - `nodes`: the ends of the intervals, s, shape (intervals + 1,);
    - `errors`: how far the states of the worst realisation drift from their equations within each interval, relative to
      the largest magnitude of each state, shape (intervals,);
    - `asked`: the error that was asked for; infinite if none was.
    """

    nodes: Float[np.ndarray, " nodes"]
    errors: Float[np.ndarray, " intervals"]
    asked: float

    @property
    def intervals(self) -> int:
        """How many intervals the mesh has."""
        return len(self.errors)

    @property
    def worst(self) -> float:
        """The largest error; zero where there are no states."""
        return float(np.max(self.errors, initial=0.0))

    @property
    def is_met(self) -> bool:
        """Whether every interval is as accurate as asked."""
        return self.worst <= self.asked

    def __str__(self) -> str:
        k = int(np.argmax(self.errors))
        place = f" from t = {self.nodes[k]:.4g} to {self.nodes[k + 1]:.4g} s"
        asked = "" if np.isinf(self.asked) else f", where {self.asked:.2g} is asked"
        drift = f"{self.intervals} intervals: states drift by {self.worst:.2g} of their magnitude in one at worst"
        return drift + place + asked
