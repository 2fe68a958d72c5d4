"""`Proportion`: a probability estimated by counting, with its exact confidence interval."""

from dataclasses import dataclass
from typing import final

import scipy

from aleator._core.shown import Printed


@final
@dataclass(frozen=True)
class Proportion(Printed):
    """A count in independent samples, as an estimate of a probability.

    `lower` and `upper` enclose the true probability with at least the given confidence (Clopper and Pearson, 1934),
    even where nothing or everything was counted.
    """

    count: int
    samples: int
    confidence: float = 0.95

    @property
    def estimate(self) -> float:
        """The observed frequency."""
        return self.count / self.samples

    @property
    def lower(self) -> float:
        """Lower end of the confidence interval."""
        tail = (1 - self.confidence) / 2
        return float(scipy.special.betaincinv(self.count, self.samples - self.count + 1, tail)) if self.count else 0.0

    @property
    def upper(self) -> float:
        """Upper end of the confidence interval."""
        tail, missed = (1 - self.confidence) / 2, self.samples - self.count
        return float(scipy.special.betaincinv(self.count + 1, missed, 1 - tail)) if missed else 1.0

    def __str__(self) -> str:
        return f"{percent(self.estimate)} ({percent(self.lower)} to {percent(self.upper)})"


def percent(probability: float) -> str:
    """Three significant digits: 11.4 %, 0.0369 %."""
    return f"{100 * probability:.3g} %"
