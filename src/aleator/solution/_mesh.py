"""`MeshError`: how well the states of a simultaneous program follow their equations on one mesh."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Drawn
from aleator.dynamics import AbstractScheme
from aleator.solution._systems import system_text


@final
@dataclass(frozen=True)
class MeshError(Drawn):
    """The error of one mesh, interval by interval.

    - `nodes`: the ends of the intervals, s, shape (intervals + 1,); `scheme`: what holds states to their equations;
    - `drifts`: how far the states of each realisation drift from their equations within each interval, relative to the
      largest magnitude of each state: of the state that drifts most, shape (realisations, intervals). Realisations are
      those of `solution.states`;
    - `asked`: the error that was asked for; infinite if none was;
    - `numbers`: the uncertain numbers of the realisation that drifts most, by name.
    """

    nodes: Float[np.ndarray, " nodes"]
    scheme: AbstractScheme
    drifts: Float[np.ndarray, "realisations intervals"]
    asked: float
    numbers: Mapping[str, float]

    @property
    def intervals(self) -> int:
        """How many intervals the mesh has."""
        return self.drifts.shape[1]

    @property
    def errors(self) -> Float[np.ndarray, " intervals"]:
        """The drift of the worst realisation of each interval."""
        return self.drifts.max(axis=0)

    @property
    def worst(self) -> float:
        """The largest error; zero where there are no states."""
        return float(self.drifts.max())

    @property
    def is_met(self) -> bool:
        """Whether every interval is as accurate as asked."""
        return self.worst <= self.asked

    def __str__(self) -> str:
        k = int(np.argmax(self.errors))
        place = f" from t = {self.nodes[k]:.4g} to {self.nodes[k + 1]:.4g} s"
        system = f" with {system_text(self.numbers)}" if self.numbers else ""
        asked = "" if np.isinf(self.asked) else f", where {self.asked:.2g} is asked"
        drift = f"states drift by {self.worst:.2g} of their magnitude at worst"
        return f"{self.intervals} intervals of {self.scheme}: {drift}{place}{system}{asked}"
