"""The methods of searches: a simplex, annealing, division of rectangles, populations, and NSGA-II for a front."""

import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import optional
from aleator.nlp._search import AbstractSearch
from aleator.nlp._sought import Sought

# Steps or generations without end: the budget ends the search, or its method.
_ENDLESS = 10**7
# The first simplex has edges of this part of the box; a simplex this small has converged.
_EDGE, _SMALL = 0.1, 1e-8
# A restart goes on only if the one before lowered the merit by more than this, in spreads of the objective.
_GAIN = 1e-8


@final
@dataclass(frozen=True)
class NelderMead(AbstractSearch):
    """The adaptive simplex (Nelder and Mead 1965; Gao and Han 2012), in SciPy, restarted where it ends: a local search.

    It follows noisy or kinked objectives downhill from the best of the first points, and needs no bounds.

    Arguments: see `AbstractSearch`.
    """

    needs_bounds: ClassVar[bool] = False
    at_once: ClassVar[bool] = False
    method: ClassVar[str] = f"Nelder-Mead (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        del generator
        point, before = first[0], np.inf
        while True:
            # A simplex within the bounds, with one corner at the point.
            edges = np.diag(np.where(point + _EDGE > sought.upper, -_EDGE, _EDGE))
            ends = {"xatol": _SMALL, "fatol": _GAIN, "maxfev": sought.limit, "maxiter": sought.limit}
            found = scipy.optimize.minimize(
                sought.merit,
                point,
                method="Nelder-Mead",
                bounds=sought.bounds,
                options={"initial_simplex": np.concatenate([point[None], point + edges]), "adaptive": True, **ends},
            )
            if not found.fun < before - _GAIN:
                return
            point, before = np.clip(found.x, sought.lower, sought.upper), found.fun


@final
@dataclass(frozen=True)
class DualAnnealing(AbstractSearch):
    """Generalised simulated annealing (Xiang et al. 1997), in SciPy: rugged objectives, one point after the other.

    Arguments: see `AbstractSearch`.
    """

    at_once: ClassVar[bool] = False
    method: ClassVar[str] = f"dual annealing (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        scipy.optimize.dual_annealing(
            sought.merit,
            sought.bounds,
            x0=first[0],
            maxiter=_ENDLESS,
            maxfun=_ENDLESS,
            no_local_search=True,  # the answer is polished with exact derivatives instead
            rng=generator,
        )


# Rectangles are divided until they are this small, as a part of the box, if the budget lasts.
_SMALLEST = 1e-5


@final
@dataclass(frozen=True)
class Direct(AbstractSearch):
    """Division of rectangles (Jones, Perttunen and Stuckman 1993), in SciPy.

    Deterministic: `seed` changes only the first points. For few variables, up to about ten.

    Arguments: see `AbstractSearch`.
    """

    at_once: ClassVar[bool] = False
    method: ClassVar[str] = f"DIRECT (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        del first, generator  # It begins in the middle of the box.
        most = max(sought.limit - sought.count, 1)
        scipy.optimize.direct(
            sought.merit,
            sought.bounds,
            maxfun=most,
            maxiter=most,
            len_tol=_SMALLEST,
            locally_biased=False,  # the answer is polished with exact derivatives instead
        )


# Populations of fewer cannot mutate.
_FEWEST_MUTATED = 5
# A population has converged if its merits differ by less than this part, or this many spreads: the rest is polishing.
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
        border.whole("DifferentialEvolution: population", self.population, least=_FEWEST_MUTATED)

    method: ClassVar[str] = f"differential evolution (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        begun = first
        while True:
            more = generator.uniform(sought.lower, sought.upper, (max(self.population - len(begun), 0), sought.size))
            scipy.optimize.differential_evolution(
                lambda points: sought.merits(points.T),
                sought.bounds,
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


# The first standard deviation, as a part of the box, and the factor of the population from one restart to the next.
_SPREAD, _GROWTH = 0.3, 2
# Generations of fewer cannot adapt.
_FEWEST_ADAPTED = 4


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
        border.whole("CmaEs: population", self.population, least=_FEWEST_ADAPTED)

    @override
    def require(self) -> None:
        _library()

    @property
    def method(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Name and version of the method."""
        _library()
        return f"CMA-ES (cmaes {importlib.metadata.version('cmaes')})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        mean, population = first[0], self.population
        while True:
            found = _library().CMA(
                mean=mean,
                sigma=_SPREAD,
                bounds=np.column_stack([sought.lower, sought.upper]),
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
    return optional("cmaes", "CmaEs", "'aleator[cma]'", "al.solvers.DifferentialEvolution()")


# Points of a generation for each point of the front that is asked for, and the fewest.
_EACH, _FEWEST_SPREAD = 2, 40
# In the place of values that are not finite: worse than all others.
_WORST = 1e30


def load_pymoo(who: str) -> tuple[Any, Any]:
    """NSGA-II and the base of problems, imported late. Raises `MissingExtraError` if pymoo is not installed."""
    nsga2 = optional("pymoo.algorithms.moo.nsga2", who, "'aleator[fronts]'")
    return nsga2.NSGA2, optional("pymoo.core.problem", who, "'aleator[fronts]'").Problem


def population_front(
    values: Callable[[Float[np.ndarray, "k n"]], tuple[np.ndarray, np.ndarray]],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    first: Float[np.ndarray, "some n"],
    *,
    points: int,
    evaluations: int,
    seed: int,
    heed: Callable[[int], None],
) -> Float[np.ndarray, "found n"]:
    """Points between bounds of which none is better in all wishes, by NSGA-II (Deb et al. 2002) of pymoo.

    - `values`: of whole generations: the wishes, shape (k, wishes), and the largest violations, shape (k,);
    - `first`: points of the first generation, the others are uniform; `points`: of the front that are asked for;
    - `heed`: called with the evaluations done before each generation; what it raises ends the search.
    """
    algorithm_of, base = load_pymoo("A population on a front")
    size = max(_EACH * points, _FEWEST_SPREAD)
    generator = np.random.default_rng(seed)
    uniform = generator.uniform(lower, upper, (max(size - len(first), 0), lower.size))
    count = len(values(first[:1])[0][0])
    problem = base(n_var=lower.size, n_obj=count, n_ieq_constr=1, xl=lower, xu=upper)
    algorithm = algorithm_of(pop_size=size, sampling=np.concatenate([first, uniform])[:size])
    algorithm.setup(problem, seed=seed, verbose=False)
    done = 0
    while done < evaluations:
        heed(done)
        asked = algorithm.ask()
        wishes, violations = values(np.clip(asked.get("X"), lower, upper))
        asked.set("F", np.nan_to_num(wishes, nan=_WORST, posinf=_WORST))
        asked.set("G", np.nan_to_num(violations, nan=_WORST, posinf=_WORST)[:, None])
        for one in asked:
            one.evaluated.update({"F", "G"})
        algorithm.tell(infills=asked)
        done += len(asked)
    return np.atleast_2d(algorithm.opt.get("X"))
