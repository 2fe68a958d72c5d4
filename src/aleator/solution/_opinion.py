"""`SecondOpinion`: a few fresh simulations of a solution, compared with its expansions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from aleator._core.shown import Printed


@final
@dataclass(frozen=True)
class SecondOpinion(Printed):
    """A few fresh simulations at the answer, compared with its expansions.

    - `samples`: how many systems were simulated;
    - `misses`: for each functional, the rms error of predicting a fresh system, relative to the standard deviation;
    - `contradictions`: one sentence for each disagreement: a functional whose prediction errs by more than twice the
      tolerance of the expansion, or an expression of the problem that the correction changes by more than four standard
      errors and by more than a hundredth of the effect of one standard deviation;
    - `broken`: why the design is no solution once the expansion is corrected: a limit that fails by more than a
      twentieth of a spread, or an objective that changes by more than was gained. Empty otherwise.

    So few systems miss rare events, such as a spike in a corner of the germ space: use `validate` for these.
    """

    samples: int
    misses: Mapping[str, float]
    contradictions: tuple[str, ...]
    broken: str

    @property
    def agrees(self) -> bool:
        """Whether the fresh simulations agree with the expansions."""
        return not self.contradictions

    def sentence(self) -> str:
        """The result in one sentence."""
        if self.agrees:
            worst = max(self.misses.values(), default=0.0)
            return f"{self.samples} fresh simulations agree, missed by {worst:.2e} of their standard deviation at worst"
        return f"{self.samples} fresh simulations disagree: {'; '.join(self.contradictions[:3])}"

    def __str__(self) -> str:
        return self.sentence()
