"""Probabilities estimated from samples, with confidence intervals: counted, or weighted by likelihood ratios."""

from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.leaves import Printed


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


@final
@dataclass(frozen=True)
class WeightedProportion(Printed):
    """The probability of an event, estimated from samples of another distribution by their likelihood ratios.

    With the weight `w` of a sample in the event and 0 elsewhere, `estimate` is the mean of the weights, which is
    unbiased whatever distribution the samples were drawn from; `variance` is the sum of their squares divided by the
    squared number of samples, and `largest` the largest weight divided by that number.

    `lower` and `upper` are those of Fay and Feuer (Statistics in Medicine 16, 1997) for weighted counts: by the gamma
    distribution, with one more count of the largest weight at the upper end; for equal weights they are the exact
    interval of a Poisson count. They are valid if the samples have met every way in which the event happens.
    """

    estimate: float
    variance: float
    largest: float
    samples: int
    confidence: float = 0.95

    @classmethod
    def of(cls, weights: Float[np.ndarray, " samples"]) -> "WeightedProportion":
        """From the weights of all samples, 0 outside the event."""
        count = len(weights)
        return cls(
            float(weights.mean()), float(np.sum(weights**2)) / count**2, float(weights.max(initial=0.0)) / count, count
        )

    @property
    def effective(self) -> float:
        """The number of equal weights with the same relative variance (Kish's effective sample size, of those in the
        event).
        """
        return self.estimate**2 / self.variance if self.variance > 0 else 0.0

    @property
    def lower(self) -> float:
        """Lower end of the confidence interval; 0 where it never happened."""
        return _gamma_quantile(self.estimate, self.variance, (1 - self.confidence) / 2) if self.variance > 0 else 0.0

    @property
    def upper(self) -> float:
        """Upper end of the confidence interval; 1 where it never happened, since nothing is known then."""
        if self.variance == 0:
            return 1.0
        mean, variance = self.estimate + self.largest, self.variance + self.largest**2
        return min(_gamma_quantile(mean, variance, (1 + self.confidence) / 2), 1.0)

    def __str__(self) -> str:
        return f"{percent(self.estimate)} ({percent(self.lower)} to {percent(self.upper)})"


Share: TypeAlias = Proportion | WeightedProportion
"""A probability estimate, counted or weighted: both have `estimate`, `lower`, `upper` and `confidence`."""


def _gamma_quantile(mean: float, variance: float, level: float) -> float:
    return float(variance / mean * scipy.special.gammaincinv(mean**2 / variance, level))
