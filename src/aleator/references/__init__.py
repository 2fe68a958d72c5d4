"""References to judge an expansion by: Monte Carlo, quasi-Monte Carlo, linearisation. Never imports `expansion`."""

from aleator.references._estimate import Estimate as Estimate
from aleator.references._estimate import RandomSample as RandomSample
from aleator.references._monte_carlo import SobolIndices as SobolIndices
from aleator.references._monte_carlo import monte_carlo as monte_carlo
from aleator.references._monte_carlo import quasi_monte_carlo as quasi_monte_carlo
from aleator.references._monte_carlo import sobol_indices as sobol_indices
from aleator.references._taylor import Linearised as Linearised
from aleator.references._taylor import SecondOrder as SecondOrder
from aleator.references._taylor import linearise as linearise
from aleator.references._taylor import second_order as second_order
