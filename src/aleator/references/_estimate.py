"""`Estimate`: a statistic estimated from a sample, with its standard error by balanced half-samples."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Bool, Float
from scipy import linalg, special

from aleator._core.errors import ProblemError

# The standard error itself then has a relative error of 1 / sqrt(2 * 31), or 13 %.
_MOST_GROUPS = 32
_SHOWN = 6


@final
@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimated number, or an array of them, and how far it may be off.

    - `value`: the estimate, in the unit of the statistic, shape (*shape);
    - `standard_error`: the standard deviation of the estimate from one sample to another, same shape and unit;
    - `groups`: how many independent groups the standard error was found from.

    Prints as `0.65923 ± 0.00030`.
    """

    value: Float[np.ndarray, "*shape"]
    standard_error: Float[np.ndarray, "*shape"]
    groups: int

    def interval(self, confidence: float = 0.95) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """Lower and upper end of the confidence interval, by Student's t distribution with `groups - 1` degrees of
        freedom.
        """
        if not 0 < confidence < 1:
            raise ProblemError(f"interval: expected a confidence between 0 and 1, such as 0.95; received {confidence}.")
        reach = special.stdtrit(self.groups - 1, (1 + confidence) / 2) * self.standard_error
        return self.value - reach, self.value + reach

    def __str__(self) -> str:
        pairs = [pair(*both) for both in zip(np.ravel(self.value), np.ravel(self.standard_error), strict=True)]
        if np.ndim(self.value) == 0:
            return pairs[0]
        rest = "" if len(pairs) <= _SHOWN else f", ... {len(pairs)} numbers"
        return f"[{', '.join(pairs[:_SHOWN])}{rest}]"


def pair(value: float, error: float) -> str:
    """A number and its standard error, which decides how many digits are shown: two of its own."""
    if not (np.isfinite(value) and np.isfinite(error) and error > 0):
        return f"{value:.6g} ± {error:.2g}"
    exponent = math.floor(math.log10(max(abs(value), error)))
    if not -4 <= exponent <= 5:
        return f"({pair(value / 10.0**exponent, error / 10.0**exponent)})e{exponent:+03d}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def group_count(samples: int) -> int:
    """How many groups a sample of independent values is taken apart into: a power of two."""
    return min(_MOST_GROUPS, 2 ** (samples.bit_length() - 1))


def estimate(statistic: Callable[[Any], Any], values: Float[np.ndarray, "samples *shape"], groups: int) -> Estimate:
    """A statistic of a sample that consists of independent groups, one after the other: a power of two of them.

    The standard error comes from balanced half-samples (McCarthy, Pseudo-replication: half samples, 1969): half of the
    groups against the other half, `groups - 1` times, chosen by the rows of a Hadamard matrix. Half the difference of
    the two halves' statistics has the standard deviation of the whole sample's; the rows are orthogonal, so that for
    statistics linear in the sample this is the spread of the groups' own values over `sqrt(groups)`, exactly.

    Half of a sample still reaches into the tails of its distribution and moves a quantile by many values: leaving out
    single groups (the jackknife) or taking each by itself (batch means) misjudges both. A quantile wants some 50 values
    beyond it. For the extremes of a sample there is no such standard error.
    """
    length = len(values) // groups
    blocks = values[: groups * length].reshape(groups, length, *values.shape[1:])

    def of_half(chosen: Bool[np.ndarray, " groups"]) -> Float[np.ndarray, "*shape"]:
        return np.asarray(statistic(blocks[chosen].reshape(-1, *values.shape[1:])))

    differences = np.stack([of_half(row > 0) - of_half(row < 0) for row in linalg.hadamard(groups)[1:]])
    # A rest that fills no group makes the estimate better, but not its standard error.
    used = groups * length / len(values)
    return Estimate(np.asarray(statistic(values)), np.sqrt(used * np.mean(differences**2, axis=0)) / 2, groups)
