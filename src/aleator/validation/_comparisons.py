"""Numbers of a solution, and limits on statistics, against samples: beyond chance and by an amount that matters.

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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.leaves import Printed
from aleator.design import Estimated, Problem, Statistic, estimated
from aleator.nlp import HELD
from aleator.references._estimate import pair
from aleator.solution import Solution
from aleator.validation._shares import Proportion, is_counted

# The two-sided probability beyond four standard deviations of a normal variable.
_RARE = math.erfc(4 / math.sqrt(2))

RELATIVE = 0.01
"""Differences up to this fraction of one system's contribution, or of the largest spread over time, are ignored."""

ROUNDING = 1e-9


def with_error(value: float, error: float) -> str:
    """A number with its standard error, where it has any."""
    return pair(value, error) if error > 0 else f"{value:.6g}"


def _when(time: float | None) -> str:
    return "" if time is None else f" at t = {time:.4g} s"


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
        estimate = with_error(self.estimate, self.standard_error)
        return f"{self.text}{_when(self.time)} is {estimate}, not {self.expected:.6g} as by {self.source}"

    __str__ = sentence


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
    floor: float = 0.0,
    times: Float[np.ndarray, " instants"] | None = None,
) -> Disagreement | None:
    """The worst disagreement of a sampled number, or one per instant, with the expected one; None if it agrees.

    Differences up to `floor` are ignored.
    """
    expected, estimate, error = np.broadcast_arrays(expected, np.asarray(estimate, float), standard_error)
    floor = max(floor, ROUNDING * float(np.max(np.abs([expected, estimate]))), 1e-300)
    limit = max(reach(freedom, estimate.size), RELATIVE * np.sqrt(samples)) * error
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(np.abs(estimate - expected) / np.maximum(limit, floor), nan=np.inf)
    ratio = np.where(np.isnan(error), 0.0, ratio)  # without a standard error there is no verdict
    i = int(np.argmax(ratio))
    if not ratio.flat[i] > 1:
        return None
    numbers = float(expected.flat[i]), float(estimate.flat[i]), float(error.flat[i])
    return Disagreement(text, *numbers, _instant(times, i, estimate.size))


def _instant(times: Float[np.ndarray, " instants"] | None, place: int, size: int) -> float | None:
    """The instant of a number among all of a path, whose values may have several components."""
    return None if times is None else float(times[place // (size // len(times))])


def is_rare(count: int, samples: int, probability: float) -> bool:
    """Whether a count disagrees with a probability, by the exact interval and by an amount that matters."""
    share = Proportion(count, samples, confidence=1 - _RARE)
    inside = share.lower <= probability <= share.upper
    return not inside and abs(share.estimate - probability) > RELATIVE * np.sqrt(probability * (1 - probability))


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
        verdict = {True: "met", False: "BROKEN", None: "within its error of the bound"}[self.meets]
        return f"{self.text}: sampled {with_error(self.value, self.standard_error)}{_when(self.time)}, {verdict}"

    __str__ = sentence


def compared(solution: Solution, problem: Problem, known: Mapping[str, Estimated], freedom: int) -> Iterator[Compared]:
    """The limits on statistics of all systems, without those that need statistics other than the `known`, by text."""
    for limit, solved in zip(problem.constraints, solution.constraints, strict=True):
        if is_counted(limit) or not any(isinstance(leaf, Statistic) for leaf in limit.expression.leaves):
            continue
        if (sampled := estimated(problem, limit.expression, known, solution.vector)) is None:
            continue
        value, error = np.ravel(sampled.value), np.ravel(sampled.error)
        lower, upper = float(limit.lower), float(limit.upper)
        beyond = np.maximum(value - upper, lower - value)
        sure = reach(freedom, value.size)
        i = int(np.argmax(beyond - sure * error))
        yield Compared(
            name=limit.name,
            text=str(limit),
            value=float(value[i]),
            standard_error=float(error[i]),
            time=_instant(solution.times_of(limit) if limit.is_path else None, i, value.size),
            bound=upper if value[i] - upper >= lower - value[i] else lower,
            beyond=float(beyond[i]),
            tolerance=HELD * solved.scale,
            reach=sure,
        )
