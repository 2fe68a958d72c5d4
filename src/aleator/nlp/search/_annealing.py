"""Generalised simulated annealing."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator.nlp.search._abstract import AbstractSearch
from aleator.nlp.search._sought import Sought

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
