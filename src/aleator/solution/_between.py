"""`Between`: whether a solution's limits over time hold between the instants of its grid."""

from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.shown import Printed
from aleator.nlp import HELD

TOLERATED = 1e-3
"""Largest relative excess of a limit between instants with which a design still counts as a solution."""

_COSTLY = 0.05


@final
@dataclass(frozen=True)
class Between(Printed):
    """The worst excess of a limit over time between the instants, found on a finer grid.

    - `factor`: how many times as many steps that grid has;
    - `worst`: the excess relative to the bound, or to the constraint's scale if the bound is zero; zero if all hold;
    - `name`: the constraint that is exceeded most; `time`: when (s), NaN for a peak;
    - `is_strict`: whether the design depends on what happens between instants: because bounds were tightened for it, or
      because the system follows trajectories. Evidence then counts violations on the finer grid too;
    - `cost`: how much worse the objective is than the optimum that holds at the instants alone, relative to it: what
      tightening costs at most. The best design that holds between instants too lies between these two.
    """

    factor: int
    worst: float
    name: str
    time: float
    is_strict: bool = False
    cost: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether all limits hold there, to tolerance."""
        return self.worst <= HELD

    @property
    def is_costly(self) -> bool:
        """Whether bounds were tightened at instants so much that a finer grid may have a considerably better design."""
        return self.cost_ratio > 1

    @property
    def cost_ratio(self) -> float:
        """The cost over the largest that is accepted without a warning."""
        return self.cost / _COSTLY

    def sentence(self) -> str:
        """Whether all limits hold, or which does not and by how much."""
        if self.holds:
            cost = f"{self.cost:.2g} of the objective: use more steps, or refine=True" if self.is_costly else ""
            tightened = f", by bounds tightened at the instants, which may cost up to {cost}" if cost else ""
            return f"limits over time hold on {self.factor} times as many steps too{tightened}"
        when = "" if np.isnan(self.time) else f" after t = {self.time:.4g} s"
        if np.isinf(self.worst):
            return f"between the instants of the grid '{self.name}' is not a number{when}: use more steps"
        return (
            f"between the instants of the grid '{self.name}' exceeds its bound by {self.worst:.2g} of it{when}: "
            "use more steps"
        )

    def __str__(self) -> str:
        return self.sentence()
