"""Shares of systems that break limits, with confidence intervals, and the limits against which these are counted."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
import scipy
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator._core.leaves import Printed
from aleator.design import AbstractFunctional, Constraint, Expression, Extreme, Problem, Statistic


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
    def effective(self) -> float:
        """How many were counted, as that of a weighted proportion."""
        return float(self.count)

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
"""A probability estimate, counted or weighted: both have `estimate`, `lower`, `upper`, `effective` and `confidence`."""


def _gamma_quantile(mean: float, variance: float, level: float) -> float:
    return float(variance / mean * scipy.special.gammaincinv(mean**2 / variance, level))


_NOISE = "a limit beside white noise, of which no sampled system has any (al.processes.RandomProcess is counted)"


def is_counted(problem: Problem, constraint: Constraint) -> bool:
    """Whether systems can be counted against a constraint: it applies to a single system, and is not an equality."""
    return not reason_uncounted(problem, constraint)


def reason_uncounted(problem: Problem, constraint: Constraint) -> str:
    """Why no system is counted against a constraint; empty if systems are."""
    expression = constraint.expression
    if float(constraint.lower) == float(constraint.upper):
        return "an equality, which no single system meets"
    if _speaks_of_one_system(expression):
        return _NOISE if problem.has_noise else ""
    if any(isinstance(atom, Statistic) for atom in expression.atoms):
        return "a statistic of all systems together"
    inside = any(isinstance(atom, Statistic) for atom in expression.leaves)
    return "a function or an integral of statistics" if inside else "numbers of the design alone"


def _speaks_of_one_system(expression: Expression) -> bool:
    """Whether it involves the value of a single system: a spread, or the gap between two quantiles, does not."""
    if any(isinstance(atom, Extreme) for atom in expression.atoms):
        return True
    factors: dict[tuple[AbstractFunctional, ...], float] = {}
    for factor, atom in zip(expression.factors, expression.atoms, strict=True):
        if isinstance(atom, Statistic) and atom.kind.speaks_of_one_system:
            factors[atom.functionals] = factors.get(atom.functionals, 0.0) + float(factor)
    return any(factor != 0 for factor in factors.values())


def check_counted(who: str, names: Sequence[str], counted: Collection[str]) -> None:
    """Raise `ProblemError` for no names, and for any but those of constraints against which systems are counted."""
    if not counted:
        raise ProblemError(
            f"{who}: no limit here applies to single systems, so none is counted; print(evidence) says why."
        )
    unknown = [name for name in names if name not in counted]
    if unknown or not names:
        raise ProblemError(
            f"{who}: expected names of constraints against which systems are counted, {list(counted)}; received "
            f"{unknown}."
        )


def broken_by(
    problem: Problem, excess: Float[np.ndarray, "constraints systems"]
) -> dict[str, Bool[np.ndarray, " systems"]]:
    """Which systems break any limit of each name against which they are counted, from their excess over each."""
    broken: dict[str, Bool[np.ndarray, " systems"]] = {}
    for limit, beyond in zip(problem.constraints, excess, strict=True):
        if is_counted(problem, limit):
            broken[limit.name] = broken.get(limit.name, False) | (beyond > 0)
    return broken
