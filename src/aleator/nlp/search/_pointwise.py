"""Searches that go from one point to the next: a simplex, simulated annealing, and division of rectangles."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator.nlp.search._abstract import AbstractSearch
from aleator.nlp.search._sought import Sought

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

    @property
    @override
    def method(self) -> str:
        return f"Nelder-Mead (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        del generator
        point, before = first[0], np.inf
        while True:
            found = scipy.optimize.minimize(
                sought.merit,
                point,
                method="Nelder-Mead",
                bounds=scipy.optimize.Bounds(sought.lower, sought.upper),
                options={
                    "initial_simplex": _simplex(sought, point),
                    "adaptive": True,
                    "xatol": _SMALL,
                    "fatol": _GAIN,
                    "maxfev": sought.limit,
                    "maxiter": sought.limit,
                },
            )
            if not found.fun < before - _GAIN:
                return
            point, before = np.clip(found.x, sought.lower, sought.upper), found.fun


def _simplex(sought: Sought, point: Float[np.ndarray, " size"]) -> Float[np.ndarray, "corners size"]:
    """A simplex within the bounds, with one corner at the point."""
    outside = point + _EDGE > sought.upper
    return np.concatenate([point[None], point + np.diag(np.where(outside, -_EDGE, _EDGE))])


# The budget ends the search.
_ENDLESS = 10**7


@final
@dataclass(frozen=True)
class DualAnnealing(AbstractSearch):
    """Generalised simulated annealing (Xiang et al. 1997), in SciPy: rugged objectives, one point after the other.

    Arguments: see `AbstractSearch`.
    """

    at_once: ClassVar[bool] = False

    @property
    @override
    def method(self) -> str:
        return f"dual annealing (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        scipy.optimize.dual_annealing(
            sought.merit,
            scipy.optimize.Bounds(sought.lower, sought.upper),
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

    @property
    @override
    def method(self) -> str:
        return f"DIRECT (SciPy {scipy.__version__})"

    @override
    def explore(self, sought: Sought, first: Float[np.ndarray, "k size"], generator: np.random.Generator) -> None:
        del first, generator  # It begins in the middle of the box.
        most = max(sought.limit - sought.count, 1)
        scipy.optimize.direct(
            sought.merit,
            scipy.optimize.Bounds(sought.lower, sought.upper),
            maxfun=most,
            maxiter=most,
            len_tol=_SMALLEST,
            locally_biased=False,  # the answer is polished with exact derivatives instead
        )
