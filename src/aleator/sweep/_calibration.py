"""`Calibration`: the margin found, its target, and the result on fresh systems."""

from dataclasses import dataclass
from typing import final

from aleator._core.shown import Drawn, Printed
from aleator.solution import Solution
from aleator.validation import Evidence, Proportion, Share


@final
@dataclass(frozen=True)
class Trial(Printed):
    """One multiple of the standard deviation that was tried: its optimal design and how often it is violated."""

    sigmas: float
    solution: Solution
    violation: Share

    def __str__(self) -> str:
        return f"{self.sigmas:8.4f} {self.solution.objective:12.6g}  {self.violation}"


@final
@dataclass(frozen=True)
class Calibration(Drawn):
    """The margin whose design is violated no more often than the target. `print(calibration)` shows it.

    - `names`: the limits; a system that breaks any of them counts; `target`: how often that may happen;
    - `trials`: all trials, on the same random sample; `chosen`: the recommended one;
    - `confirmation`: how often fresh systems, not used in the search, violate the chosen design; None where none were
      drawn. Its interval is wide enough that at most one calibration in forty confirms a design that is violated more
      often than the target, however many looks at fresh systems were needed;
    - `evidence`: the chosen design on fresh systems; for rare violations a second sample, besides `confirmation`;
    - `missing`: what is needed to confirm it, empty if it is confirmed; `interrupted`: whether it was stopped early.
    """

    names: tuple[str, ...]
    target: float
    trials: tuple[Trial, ...]
    chosen: Trial
    confirmation: Share | None
    evidence: Evidence | None
    missing: str = ""
    interrupted: bool = False

    @property
    def confirmed(self) -> bool:
        """Whether the upper end of the interval on fresh systems is at or below the target."""
        return self.confirmation is not None and self.confirmation.upper <= self.target

    @property
    def name(self) -> str:
        """The limits' names as text."""
        return " or ".join(self.names)

    @property
    def sigmas(self) -> float:
        """The calibrated multiple of the standard deviation; the largest of several limits: see `margins`."""
        return self.chosen.sigmas

    @property
    def margins(self) -> dict[str, float]:
        """The calibrated multiples of the limits, by their names."""
        problem = self.solution.problem
        return {name: max(one.expression.sigmas or 0.0 for one in problem.named(name)) for name in self.names}

    @property
    def solution(self) -> Solution:
        """The design with this margin."""
        return self.chosen.solution

    def sentence(self, who: str = "systems") -> str:
        """The target, whether it is confirmed, and with which confidence, in one sentence."""
        fresh = "" if self.confirmation is None else _fresh(self.confirmation, who)
        if self.confirmed:
            return f"confirmed for the target of {100 * self.target:g} %: {fresh}"
        said = "; ".join(filter(None, [fresh, self.missing]))
        return f"not confirmed for the target of {100 * self.target:g} %: {said}"

    def __str__(self) -> str:
        rows = [f"{'sigmas':>8} {'objective':>12}  violates {self.name}"]
        rows += [str(one) for one in self.trials]
        rows.append(f"chosen: {self.sigmas:.4f}, {self.sentence()}")
        return "\n".join(rows)


def _fresh(share: Share, who: str) -> str:
    how = "" if isinstance(share, Proportion) else f", weighted, with {share.effective:.0f} effective violations"
    return f"{share} of {share.samples} fresh {who}{how}, at {100 * share.confidence:g} % confidence"
