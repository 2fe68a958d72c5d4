"""DIRECT: division of rectangles."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator.nlp.search._abstract import AbstractSearch
from aleator.nlp.search._sought import Sought

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
