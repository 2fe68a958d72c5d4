"""`Calibration`: the margin found, what was promised of it and what fresh systems say."""

from dataclasses import dataclass
from typing import final

from aleator.solution import Solution
from aleator.validation import Evidence, Proportion, Share


@final
@dataclass(frozen=True)
class Trial:
    """One multiple of the standard deviation that was tried: its optimal design and how often that is violated."""

    sigmas: float
    solution: Solution
    violation: Share

    def __str__(self) -> str:
        return f"{self.sigmas:8.4f} {self.solution.objective:12.6g}  {self.violation}"


@final
@dataclass(frozen=True)
class Calibration:
    """The margin whose design is violated no more often than asked. `print(calibration)` shows it.

    - `names`: the limits; a system that breaks any of them violates; `target`: how often it may;
    - `trials`: all that was tried, on one and the same random sample; `chosen`: the one that is recommended;
    - `confirmation`: how often fresh systems, in no part of the search, violate the chosen design, None where it did
      not come to that. Its interval is so wide that of all calibrations at most one in forty confirms a design that is
      violated more often than asked, however often fresh systems had to be looked at;
    - `evidence`: the chosen design on fresh systems; of rare violations it is a second sample, beside `confirmation`;
    - `missing`: what it takes to confirm it, empty if it is confirmed; `interrupted`: whether it was stopped early.
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
        """Whether the upper end of the interval on fresh systems lies at the target or below."""
        return self.confirmation is not None and self.confirmation.upper <= self.target

    @property
    def name(self) -> str:
        """The limits in words."""
        return " or ".join(self.names)

    @property
    def sigmas(self) -> float:
        """The calibrated multiple of the standard deviation, of several limits the largest: see `margins`."""
        return self.chosen.sigmas

    @property
    def margins(self) -> dict[str, float]:
        """The calibrated multiples of the limits, by their names."""
        problem = self.solution.problem
        return {name: max(one.expression.sigmas or 0.0 for one in problem.named(name)) for name in self.names}

    @property
    def solution(self) -> Solution:
        """The design it gives."""
        return self.chosen.solution

    def sentence(self, who: str = "systems") -> str:
        """What was promised, whether it is confirmed and with which confidence, in one sentence."""
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
    how = "" if isinstance(share, Proportion) else f", weighted, worth {share.effective:.0f} that violate"
    return f"{share} of {share.samples} fresh {who}{how}, at {100 * share.confidence:g} % confidence"
