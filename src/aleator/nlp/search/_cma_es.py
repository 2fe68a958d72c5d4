"""Covariance matrix adaptation."""

import importlib.metadata
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core import given
from aleator._core.errors import MissingExtraError
from aleator.nlp.search._abstract import AbstractSearch
from aleator.nlp.search._sought import Sought

# The first standard deviation, as a part of the box, and the factor of the population from one restart to the next.
_SPREAD, _GROWTH = 0.3, 2
# A generation whose merits differ by less, in spreads of the objective, has converged: the rest is polishing.
_CONVERGED = 1e-6
# Generations of fewer cannot adapt.
_FEWEST = 4


@final
@dataclass(frozen=True)
class CmaEs(AbstractSearch):
    """Evolution with an adapted covariance matrix (Hansen 2016), restarted with twice the population at each end.

    The library cmaes (Nomura and Shibata 2024), of the extra `cma`: for ill-conditioned or noisy objectives of up to
    about a hundred variables, where differential evolution is slow. Every generation is one call of the compiled
    problem. Restarts with growing populations: Auger and Hansen 2005.

    - `population`: points of the first generations; others: see `AbstractSearch`.
    """

    evaluations: int = 5000
    population: int = 16

    def __post_init__(self) -> None:
        super().__post_init__()
        given.whole("CmaEs: population", self.population, least=_FEWEST)

    @override
    def require(self) -> None:
        _library()

    @property
    @override
    def method(self) -> str:
        _library()
        return f"CMA-ES (cmaes {importlib.metadata.version('cmaes')})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        mean, population = first[0], self.population
        while True:
            found = _library().CMA(
                mean=mean,
                sigma=_SPREAD,
                bounds=np.stack([sought.lower, sought.upper], axis=1),
                seed=int(generator.integers(2**31)),
                population_size=population,
            )
            merits = np.array([0.0, np.inf])
            while np.ptp(merits) > _CONVERGED and not found.should_stop():
                points = [found.ask() for _ in range(population)]
                merits = sought.merits(np.array(points))
                found.tell(list(zip(points, merits.tolist(), strict=True)))
            mean, population = generator.uniform(sought.lower, sought.upper), _GROWTH * population


def _library() -> Any:
    try:
        import cmaes
    except ImportError as error:
        raise MissingExtraError(
            "`CmaEs` needs the library cmaes: install it with `pip install 'aleator[cma]'`, or use "
            "al.solvers.DifferentialEvolution()."
        ) from error
    return cmaes
