"""`Estimate`: a statistic estimated from a sample, with its standard error by balanced half-samples; `RandomSample`."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import jax
import numpy as np
import scipy
from jaxtyping import Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.ensemble import Function, part
from aleator.statistics import AbstractMeasured, AbstractStatistic, Correlation, Covariance, a_statistic

# With this many groups the standard error itself has a relative error of 1 / sqrt(2 * 31), or 13 %.
_MOST_GROUPS = 32
_SHOWN = 6


@final
@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimated number, or an array of them, with its standard error.

    - `value`: the estimate, in the unit of the statistic, shape (*shape);
    - `standard_error`: the standard deviation of the estimate between samples, in the same shape and unit;
    - `groups`: the number of independent groups that the standard error was computed from.

    Prints as `0.65923 ± 0.00030`.
    """

    value: Float[np.ndarray, "*shape"]
    standard_error: Float[np.ndarray, "*shape"]
    groups: int

    def interval(self, confidence: float = 0.95) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """The confidence interval (lower, upper), by Student's t distribution with `groups - 1` degrees of freedom."""
        if not 0 < confidence < 1:
            raise ProblemError(f"interval: expected a confidence between 0 and 1, such as 0.95; received {confidence}.")
        reach = scipy.special.stdtrit(self.groups - 1, (1 + confidence) / 2) * self.standard_error
        return self.value - reach, self.value + reach

    def __str__(self) -> str:
        pairs = [pair(*both) for both in zip(np.ravel(self.value), np.ravel(self.standard_error), strict=True)]
        if np.ndim(self.value) == 0:
            return pairs[0]
        rest = "" if len(pairs) <= _SHOWN else f", ... {len(pairs)} numbers"
        return f"[{', '.join(pairs[:_SHOWN])}{rest}]"


def pair(value: float, error: float) -> str:
    """A number and its standard error as text, with as many digits as show two of the standard error."""
    if not (np.isfinite(value) and np.isfinite(error) and error > 0):
        return f"{value:.6g} ± {error:.2g}"
    exponent = math.floor(math.log10(max(abs(value), error)))
    if not -4 <= exponent <= 5:
        return f"({pair(value / 10.0**exponent, error / 10.0**exponent)})e{exponent:+03d}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def group_count(samples: int) -> int:
    """How many groups a sample of independent values is split into: a power of two."""
    return min(_MOST_GROUPS, 2 ** (samples.bit_length() - 1))


def estimate(statistic: Callable[[Any], Any], values: Float[np.ndarray, "samples *shape"], groups: int) -> Estimate:
    """A statistic of a sample that consists of independent groups one after the other, their number a power of two.

    The standard error comes from balanced half-samples (McCarthy, Pseudo-replication: half samples, 1969): half of the
    groups against the other half, `groups - 1` times, chosen by the rows of a Hadamard matrix. Half the difference of
    the two halves' statistics has the standard deviation of the whole sample's; the rows are orthogonal, so that for
    statistics linear in the sample this is the spread of the groups' own values over `sqrt(groups)`, exactly.

    Half of a sample still reaches into the tails and moves a quantile by many values; leaving out single groups (the
    jackknife) or taking each by itself (batch means) misjudges the error of quantiles. A quantile needs some 50 values
    beyond it. The extremes of a sample have no such standard error.
    """
    length = len(values) // groups
    blocks = values[: groups * length].reshape(groups, length, *values.shape[1:])

    def of_half(chosen: Bool[np.ndarray, " groups"]) -> Float[np.ndarray, "*shape"]:
        return np.asarray(statistic(blocks[chosen].reshape(-1, *values.shape[1:])))

    differences = np.stack([of_half(row > 0) - of_half(row < 0) for row in scipy.linalg.hadamard(groups)[1:]])
    # Values left over that fill no group enter the estimate, but not its standard error.
    used = groups * length / len(values)
    return Estimate(np.asarray(statistic(values)), np.sqrt(used * np.mean(differences**2, axis=0)) / 2, groups)


Estimates: TypeAlias = Any
"""An `Estimate`, or a dict of them if the outputs are a dict."""


@final
class RandomSample(AbstractMeasured[Estimates]):
    """Outputs of a function at random inputs: `sample.mean` prints as `0.65923 ± 0.00030`.

    - `values`: of each output, shape (samples, *shape), in the structure that the function returns;
    - `groups`: the number of independent groups of equal size, one after the other, from which standard errors are
      computed (see `Estimate`): arbitrary for a plain Monte Carlo sample, the replicates of a quasi-random one;
    - `seed`: of the random inputs; `seconds`: how long the evaluation took, compilation included, in the process that
      finished it.

    Every statistic has the structure of the outputs, an `Estimate` or a dict of them; `sample["y"]` selects one output
    of a dict.
    """

    def __init__(self, values: Pytree, groups: int, seed: int, seconds: float):
        self.values, self.groups, self.seed, self.seconds = values, groups, seed, seconds

    def __getitem__(self, name: str) -> "RandomSample":
        """One output by name, if the outputs are a dict."""
        return RandomSample(part(self.values, name), self.groups, self.seed, self.seconds)

    @property
    def samples(self) -> int:
        """How many inputs were drawn."""
        return len(jax.tree.leaves(self.values)[0])

    def estimate(self, statistic: AbstractStatistic | Function) -> Estimates:
        """Any statistic of each output, or any function of a sample of shape (samples, *shape)."""
        of_sample = statistic.of_sample if isinstance(statistic, AbstractStatistic) else statistic
        return jax.tree.map(lambda values: estimate(of_sample, values, self.groups), self.values)

    @override
    def statistic(self, kind: AbstractStatistic) -> Estimates:
        """An estimate of each output.

        The standard error of a probability is 0, and meaningless, if all values of the sample meet the condition or
        none does.
        """
        return self.estimate(a_statistic(kind))

    def covariance(self, first: str, second: str) -> Estimate:
        """The covariance of two outputs of equal shape, by their names."""
        return self._of_both(Covariance(), first, second)

    def correlation(self, first: str, second: str) -> Estimate:
        """The correlation coefficient of two outputs of equal shape, by their names."""
        return self._of_both(Correlation(), first, second)

    def _of_both(self, statistic: AbstractStatistic, first: str, second: str) -> Estimate:
        both = part(self.values, first), part(self.values, second)
        if both[0].shape != both[1].shape:
            raise ProblemError(
                f"'{first}' and '{second}' must have one shape; received {both[0].shape[1:]} and {both[1].shape[1:]}."
            )
        return estimate(statistic.of_sample, np.stack(both, axis=-1), self.groups)

    def __str__(self) -> str:
        means, stds = self.mean, self.std
        rows = jax.tree_util.tree_leaves_with_path(means)
        names = [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path, _ in rows]
        lines = [f"{self.samples} samples, standard errors from {self.groups} independent groups"]
        for name, (_, mean), std in zip(names, rows, jax.tree.leaves(stds), strict=True):
            lines.append(f"{name}: mean {mean}, std {std}")
        return "\n".join(lines)
