"""`RandomSample`: outputs at random inputs, and their statistics with standard errors."""

from typing import Any, TypeAlias, final

import jax
import numpy as np
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.ensemble import Function, part
from aleator.references._estimate import Estimate, estimate
from aleator.statistics import AbstractMeasured, AbstractStatistic, Correlation, Covariance, a_statistic

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
