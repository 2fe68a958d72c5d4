"""Where samples and a solution disagree, beyond chance and by an amount that matters; and limits on sampled statistics.

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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.design import Constraint, Estimated, Problem, Statistic, estimated, grid_at
from aleator.references._estimate import pair
from aleator.validation._counted import Proportion

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
