"""`Between`: how a solution's limits over time stand between the instants of its grid."""

from dataclasses import dataclass
from typing import final

import numpy as np

from aleator.nlp import HELD

TOLERATED = 1e-3
"""Between instants, a limit that is exceeded by more than this part of it makes a design no solution."""


@final
@dataclass(frozen=True)
class Between:
    """What a finer grid shows of a solution: how far limits over time are exceeded between the instants, at worst.

    - `factor`: how many times as many steps that grid has;
    - `worst`: relative to the bound, or to the constraint's scale where that is zero; zero where all hold;
    - `name`: of the constraint; `time`: when, s, not-a-number for a peak;
    - `is_strict`: whether what happens between instants shapes the design: where bounds had to be tightened for it, and
      where a system follows trajectories. Its systems are counted there too.
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
        """Whether limits hold there, or which does not, and by how much."""
        if self.holds:
            return f"limits over time hold on {self.factor} times as many steps too"
        when = "" if np.isnan(self.time) else f" after t = {self.time:.4g} s"
        if np.isinf(self.worst):
            return f"between the instants of the grid '{self.name}' is not a number{when}: use more steps"
        return (
            f"between the instants of the grid '{self.name}' exceeds its bound by {self.worst:.2g} of it{when}: "
            "use more steps"
        )
