"""`AbstractMeasured`: one list of statistics for functionals, expanded functions and samples."""

import abc
from typing import Generic, TypeVar

from aleator._core.arrays import Scalar
from aleator.statistics._extremes import Infimum, Supremum
from aleator.statistics._shape import CornishFisher, Kurtosis, Skewness
from aleator.statistics._sobol import Sobol
from aleator.statistics._statistic import AbstractStatistic, Mean, Std, Variance
from aleator.statistics._tails import ConditionalValueAtRisk, Probability, Quantile

_Result = TypeVar("_Result", covariant=True)


class AbstractMeasured(abc.ABC, Generic[_Result]):
    """A quantity that varies between realisations: a functional of a problem, an expanded function, a sample.

    Each subclass defines what `statistic` returns: an expression, numbers, or estimates with standard errors.
    """

    @abc.abstractmethod
    def statistic(self, kind: AbstractStatistic) -> _Result:
        """Any other statistic, such as one of your own."""

    @property
    def mean(self) -> _Result:
        """The expected value, equation (98)."""
        return self.statistic(Mean())

    @property
    def std(self) -> _Result:
        """The standard deviation, equation (99)."""
        return self.statistic(Std())

    @property
    def variance(self) -> _Result:
        """The variance, equation (97)."""
        return self.statistic(Variance())

    @property
    def skewness(self) -> _Result:
        """The third central moment over `std**3`: zero for a normal distribution, positive for a longer upper tail."""
        return self.statistic(Skewness())

    @property
    def kurtosis(self) -> _Result:
        """The fourth central moment over `std**4`: 3 for a normal distribution."""
        return self.statistic(Kurtosis())

    @property
    def supremum(self) -> _Result:
        """The largest value; for an expansion an upper bound (equation 88), which the model may exceed.

        Raises `ProblemError` for an expansion in unbounded distributions.
        """
        return self.statistic(Supremum())

    @property
    def infimum(self) -> _Result:
        """The smallest value; for an expansion a lower bound (equation 88), below which the model may fall.

        Raises `ProblemError` for an expansion in unbounded distributions.
        """
        return self.statistic(Infimum())

    def quantile(self, level: Scalar) -> _Result:
        """The value that is not exceeded with probability `level`, between 0 and 1."""
        return self.statistic(Quantile(level))

    def cornish_fisher(self, level: Scalar) -> _Result:
        """The quantile at `level` from the first four moments: smooth, and accurate close to a normal distribution."""
        return self.statistic(CornishFisher(level))

    def probability(self, *, above: Scalar | None = None, below: Scalar | None = None) -> _Result:
        """The probability of more than `above`, of less than `below`, or of both at once."""
        return self.statistic(Probability(above=above, below=below))

    def conditional_value_at_risk(self, level: Scalar, *, lower: bool = False) -> _Result:
        """The mean of the values above the quantile at `level`, or with `lower=True` of those below it."""
        return self.statistic(ConditionalValueAtRisk(level, lower=lower))

    def sobol(self, *variables: str) -> _Result:
        """The Sobol index of one germ variable, or of the interaction of several: its share of the variance.

        Raises `ProblemError` for correlated and for unknown variables, and for a sample, which does not determine it.
        """
        return self.statistic(Sobol(variables))

    def total_sobol(self, variable: str) -> _Result:
        """The total Sobol index of a germ variable: its share of the variance, alone or together with others.

        Raises `ProblemError` for correlated and for unknown variables, and for a sample, which does not determine it.
        """
        return self.statistic(Sobol((variable,), total=True))
