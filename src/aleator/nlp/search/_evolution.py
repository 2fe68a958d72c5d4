"""Differential evolution."""

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core import given
from aleator.nlp.search._abstract import AbstractSearch
from aleator.nlp.search._sought import Sought

# Populations of fewer cannot mutate.
_FEWEST = 5
# Generations without end: the budget ends the search, or the population's spread.
_ENDLESS = 10**6
# The population has converged if its merits differ by less than this part, or this many spreads.
_CONVERGED = 1e-6


@final
@dataclass(frozen=True)
class DifferentialEvolution(AbstractSearch):
    """Differential evolution (Storn and Price 1997), in SciPy: many minima, few variables, finite bounds.

    Every generation is one call of the compiled problem. Where a population has converged, another one begins.

    - `population`: points of a generation; about ten for each decision are usual;
    - others: see `AbstractSearch`.
    """

    evaluations: int = 5000
    population: int = 48

    def __post_init__(self) -> None:
        super().__post_init__()
        given.whole("DifferentialEvolution: population", self.population, least=_FEWEST)

    @property
    @override
    def method(self) -> str:
        return f"differential evolution (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        begun = first
        while True:
            more = generator.uniform(sought.lower, sought.upper, (max(self.population - len(begun), 0), sought.size))
            scipy.optimize.differential_evolution(
                lambda points: sought.merits(points.T),
                scipy.optimize.Bounds(sought.lower, sought.upper),
                init=np.concatenate([begun, more])[: self.population],
                maxiter=_ENDLESS,
                tol=_CONVERGED,
                atol=_CONVERGED,
                vectorized=True,
                updating="deferred",
                polish=False,
                rng=generator,
            )
            begun = np.zeros((0, sought.size))
