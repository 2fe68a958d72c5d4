"""From the coefficients of an expansion to its statistics."""

from aleator.statistics._extremes import Infimum as Infimum
from aleator.statistics._extremes import Supremum as Supremum
from aleator.statistics._joint import CoefficientProduct as CoefficientProduct
from aleator.statistics._joint import Correlation as Correlation
from aleator.statistics._joint import Covariance as Covariance
from aleator.statistics._lines import lines_through as lines_through
from aleator.statistics._moments import Mean as Mean
from aleator.statistics._moments import Std as Std
from aleator.statistics._moments import Variance as Variance
from aleator.statistics._moments import root as root
from aleator.statistics._moments import varies as varies
from aleator.statistics._shape import CornishFisher as CornishFisher
from aleator.statistics._shape import Kurtosis as Kurtosis
from aleator.statistics._shape import Skewness as Skewness
from aleator.statistics._sobol import Sobol as Sobol
from aleator.statistics._sobol import TotalSobol as TotalSobol
from aleator.statistics._sobol import refuse_correlated as refuse_correlated
from aleator.statistics._statistic import AbstractStatistic as AbstractStatistic
from aleator.statistics._statistic import Constants as Constants
from aleator.statistics._statistic import Preparation as Preparation
from aleator.statistics._statistic import prepare as prepare
from aleator.statistics._tails import ConditionalValueAtRisk as ConditionalValueAtRisk
from aleator.statistics._tails import Probability as Probability
from aleator.statistics._tails import Quantile as Quantile
from aleator.statistics._tails import cdf as cdf
from aleator.statistics._tails import pdf as pdf
