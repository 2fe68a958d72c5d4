"""From the coefficients of an expansion to its statistics."""

from aleator.statistics._moments import mean as mean
from aleator.statistics._moments import std as std
from aleator.statistics._moments import variance as variance
