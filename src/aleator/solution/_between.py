"""`Between`: whether a solution's limits over time hold between the instants of its grid."""

from dataclasses import dataclass
from typing import final

import numpy as np

from aleator.nlp import HELD

TOLERATED = 1e-3
"""Largest relative excess of a limit between instants with which a design still counts as a solution."""


@final
@dataclass(frozen=True)
class Between:
    """The worst excess of a limit over time between the instants, found on a finer grid.

    - `factor`: how many times as many steps that grid has;
    - `worst`: the excess relative to the bound, or to the constraint's scale if the bound is zero; zero if all hold;
    - `name`: the constraint that is exceeded most; `time`: when (s), NaN for a peak;
    - `is_strict`: whether the design depends on what happens between instants: because bounds were tightened for it, or
      because the system follows trajectories. Evidence then counts violations on the finer grid too.
    """

    factor: int
    worst: float
    name: str
    time: float
    is_strict: bool = False

    @property
    def holds(self) -> bool:
        """Whether all limits hold there, to tolerance."""
        return self.worst <= HELD

    def sentence(self) -> str:
        """Whether all limits hold, or which does not and by how much."""
        if self.holds:
            return f"limits over time hold on {self.factor} times as many steps too"
        when = "" if np.isnan(self.time) else f" after t = {self.time:.4g} s"
        if np.isinf(self.worst):
            return f"between the instants of the grid '{self.name}' is not a number{when}: use more steps"
        return (
            f"between the instants of the grid '{self.name}' exceeds its bound by {self.worst:.2g} of it{when}: "
            "use more steps"
        )

    def __str__(self) -> str:
        return self.sentence()
