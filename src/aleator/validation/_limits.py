"""Limits against samples: which of them single systems are counted against, with exact confidence intervals; those on
statistics; and where samples and a solution disagree, beyond chance and by an amount that matters.

Two numbers disagree if they differ by more than four standard errors of the sampled one, and by more than a hundredth
of what one system contributes (the standard error times the square root of the number of samples): a larger sample
resolves more, but a difference of a thousandth is never a disagreement. Where many instants are compared, Bonferroni's
correction accounts for the worst of them by chance.

Over time, a difference below a hundredth of the largest spread at any instant is not a disagreement either, as in the
second opinion on a solution. For example, where a distance is initially to a part that does not move, its spread starts
from zero with a kink: all points of the expansion may agree there to rounding, while one system in a thousand has moved
slightly.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.leaves import Printed
from aleator.design import (
    AbstractFunctional,
    Constraint,
    Estimated,
    Expression,
    Extreme,
    Problem,
    Statistic,
    estimated,
    grid_at,
)
from aleator.nlp import HELD
from aleator.references._estimate import pair
from aleator.solution import Solution


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


_AN_ORDER_BELOW = 0.1


def is_counted(constraint: Constraint) -> bool:
    """Whether systems can be counted against a constraint: it applies to a single system, and is not an equality."""
    return not _reason(constraint)


def uncounted(problem: Problem) -> dict[str, str]:
    """The constraints against which no system is counted, as mathematics, with the reasons."""
    return {str(one): reason for one in problem.constraints if (reason := _reason(one))}


def check_counted(who: str, names: Sequence[str], counted: Collection[str]) -> None:
    """Raise `ProblemError` for no names, and for any but those of constraints against which systems are counted."""
    unknown = [name for name in names if name not in counted]
    if unknown or not names:
        raise ProblemError(
            f"{who}: expected names of constraints against which systems are counted, {list(counted)}; received "
            f"{unknown}."
        )


def tolerances(solution: Solution) -> Float[np.ndarray, " constraints"]:
    """The excess over each constraint that does not count as a violation, so that rounding does not break a limit."""
    return np.array([HELD * one.scale for one in solution.constraints])


def why_uncounted(problem: Problem, name: str) -> str:
    """Why no system can be counted against the constraints called `name`; empty where it can."""
    reasons = [_reason(one) for one in problem.named(name)]
    return "" if "" in reasons else reasons[0]


def sampled_by(solution: Solution) -> int:
    """The refinement factor, relative to a solution's own grid, of the grid for sampling systems.

    1 if the error of its own grid is an order of magnitude below the tolerance; otherwise that of the grid used to
    estimate it.
    """
    error = solution.certificate.grid_error
    return 1 if error is None or error.ratio <= _AN_ORDER_BELOW else error.factor


def finer_by(solution: Solution) -> int:
    """The refinement factor, relative to a solution's own grid, of the grid for counting against limits over time.

    It is that of the grid on which limits were held between instants, if they were; otherwise that of all samples.
    """
    between = solution.certificate.between
    return between.factor if between is not None and between.is_strict else sampled_by(solution)


def _reason(constraint: Constraint) -> str:
    """Why no system is counted against a constraint; empty if systems are."""
    expression = constraint.expression
    if float(constraint.lower) == float(constraint.upper):
        return "an equality, which no single system meets"
    if _speaks_of_one_system(expression):
        return ""
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


# The two-sided probability beyond four standard deviations of a normal variable.
_RARE = math.erfc(4 / math.sqrt(2))

_RELATIVE = 0.01
"""Differences up to this fraction of one system's contribution, or of the largest spread over time, are ignored."""

_ROUNDING = 1e-9


@final
@dataclass(frozen=True)
class Disagreement(Printed):
    """A number of the solution that fresh simulations contradict.

    - `text`: the number as mathematics, such as `σ[x(t)]`; `time`: the worst instant (s), None for a number;
    - `expected`: its value by the solution, of which `source` names the part; `estimate`, `standard_error`: by the
      samples.
    """

    text: str
    expected: float
    estimate: float
    standard_error: float
    time: float | None = None
    source: str = "the expansion"

    def sentence(self) -> str:
        """The sampled and the expected value."""
        when = "" if self.time is None else f" at t = {self.time:.4g} s"
        found = f"{self.estimate:.6g}" if not self.standard_error > 0 else pair(self.estimate, self.standard_error)
        return f"{self.text}{when} is {found}, not {self.expected:.6g} as by {self.source}"

    def __str__(self) -> str:
        return self.sentence()


def reach(freedom: int, comparisons: int = 1) -> float:
    """How many standard errors are beyond chance, by Student's t: four for one comparison and a large sample."""
    return float(-scipy.special.stdtrit(freedom, _RARE / 2 / comparisons))


def worst_disagreement(
    text: str,
    expected: Float[np.ndarray, "*shape"],
    estimate: Float[np.ndarray, "*shape"],
    standard_error: Float[np.ndarray, "*shape"],
    *,
    samples: int,
    freedom: int,
    size: float = 0.0,
    spread: float = 0.0,
    known: float = 0.0,
    times: Float[np.ndarray, " instants"] | None = None,
) -> Disagreement | None:
    """The worst disagreement of a sampled number, or one per instant, with the expected one; None if it agrees.

    `size` is a magnitude to which rounding is relative, besides those of the numbers themselves; `spread`, for a
    functional over time, its largest standard deviation at any instant; `known`, a difference reported elsewhere.
    """
    expected, estimate, standard_error = (np.asarray(one, float) for one in (expected, estimate, standard_error))
    expected = np.broadcast_to(expected, estimate.shape)
    rounding = _ROUNDING * max(float(np.max(np.abs(expected))), float(np.max(np.abs(estimate))), size)
    floor = max(rounding, _RELATIVE * spread, known)
    limit = max(reach(freedom, estimate.size), _RELATIVE * np.sqrt(samples)) * standard_error
    allowed = np.maximum(limit, floor)
    difference = np.abs(estimate - expected)
    # Without a standard error there is no verdict.
    ratio = np.where(np.isnan(allowed) | (difference == 0), 0.0, difference / np.where(allowed > 0, allowed, 1e-300))
    i = int(np.argmax(ratio))
    if not ratio.flat[i] > 1:
        return None
    when = None if times is None else float(times[i // (estimate.size // len(times))])
    return Disagreement(text, float(expected.flat[i]), float(estimate.flat[i]), float(standard_error.flat[i]), when)


def is_rare(count: int, samples: int, probability: float) -> bool:
    """Whether a count disagrees with a probability, by the exact interval and by an amount that matters."""
    share = Proportion(count, samples, confidence=1 - _RARE)
    inside = share.lower <= probability <= share.upper
    return not inside and abs(share.estimate - probability) > _RELATIVE * np.sqrt(probability * (1 - probability))


# Half-width of a 95 % confidence interval, in standard errors.
_CONFIDENT = 1.96


@final
@dataclass(frozen=True)
class Compared(Printed):
    """A limit on a statistic, evaluated with the sampled statistic instead of the expansion's.

    - `value`, `standard_error`: its expression by the samples, at the `time` (s) closest to or furthest beyond the
      bound, None for a number; the error is an upper bound where it contains several statistics;
    - `bound`: the nearer, or the more exceeded, of the two bounds; `beyond`: by how much it is exceeded, negative
      inside; `tolerance`: the excess that is ignored;
    - `reach`: how many standard errors are beyond chance, given the number of its instants.
    """

    name: str
    text: str
    value: float
    standard_error: float
    time: float | None
    bound: float
    beyond: float
    tolerance: float
    reach: float

    @property
    def meets(self) -> bool | None:
        """Whether the limit is met, with 95 % confidence; None where the samples cannot decide."""
        # NaN meets no limit; an extreme has no standard error.
        if np.isnan(self.beyond) or self.beyond > self.tolerance + self.reach * self.standard_error:
            return False
        return True if self.beyond + _CONFIDENT * self.standard_error <= self.tolerance else None

    def sentence(self) -> str:
        """The sampled value, and the verdict on the limit."""
        when = "" if self.time is None else f" at t = {self.time:.4g} s"
        found = f"{self.value:.6g}" if not self.standard_error > 0 else pair(self.value, self.standard_error)
        verdict = {True: "met", False: "BROKEN", None: "within its error of the bound"}[self.meets]
        return f"{self.text}: sampled {found}{when}, {verdict}"

    def __str__(self) -> str:
        return self.sentence()


def compared(
    problem: Problem,
    constraint: Constraint,
    known: Mapping[str, Estimated],
    decisions: Float[np.ndarray, " n"],
    tolerance: float,
    freedom: int,
) -> Compared | None:
    """A limit evaluated with sampled statistics, `known` by their texts; None where one that it needs is missing."""
    expression = constraint.expression
    if not any(isinstance(leaf, Statistic) for leaf in expression.leaves):
        return None
    found = estimated(problem, expression, known, decisions)
    if found is None:
        return None
    value, error = found
    times = np.asarray(grid_at(problem, jnp.asarray(decisions)).times)
    lower, upper = float(constraint.lower), float(constraint.upper)
    beyond = np.maximum(value - upper, lower - value)
    sure = reach(freedom, value.size)
    i = int(np.argmax(beyond - sure * error))
    when = float(times[i // (value.size // len(times))]) if constraint.is_path else None
    worst, off, far = (float(np.ravel(part)[i]) for part in (value, error, beyond))
    bound = upper if worst - upper >= lower - worst else lower
    return Compared(constraint.name, str(constraint), worst, off, when, bound, far, tolerance, sure)
