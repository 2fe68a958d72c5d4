"""`SecondOpinion`: what a few fresh simulations say of the expansions of a solution."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class SecondOpinion:
    """What a few fresh simulations at the answer say of its expansions.

    - `samples`: how many systems were simulated;
    - `misses`: of each functional, the rms error of predicting a fresh system, relative to the standard deviation;
    - `contradictions`: where they contradict the expansion, a sentence each: functionals that are missed by more than
      twice the tolerance of the expansion, and expressions of the problem that move by more than four standard errors
      and by more than a hundredth of what one spread makes of them;
    - `broken`: the limit that does not hold once the expansion is corrected, by more than a twentieth of a spread, or
      that the objective moves by more than was gained: the design is no solution then. Empty otherwise.

    Spikes that few systems meet are not seen by so few: that is what `validate` is for.
    """

    samples: int
    misses: Mapping[str, float]
    contradictions: tuple[str, ...]
    broken: str

    @property
    def agrees(self) -> bool:
        """Whether the fresh simulations are as the expansions predict."""
        return not self.contradictions

    def sentence(self) -> str:
        """What they say, in words."""
        if self.agrees:
            worst = max(self.misses.values(), default=0.0)
            return f"{self.samples} fresh simulations agree, missed by {worst:.2e} of their standard deviation at worst"
        return f"{self.samples} fresh simulations disagree: {'; '.join(self.contradictions[:3])}"
