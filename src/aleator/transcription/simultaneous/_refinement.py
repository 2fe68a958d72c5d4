"""How a mesh is refined: its intervals are divided, or all are given more stages, whichever takes fewer points.

Where states are smooth, errors fall geometrically with the number of stages; where they are not, only shorter intervals
help (Patterson, Hager and Rao, Optimal Control Applications and Methods 36 (2015) 398).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from aleator.dynamics import AbstractScheme
from aleator.transcription.simultaneous._mesh_error import Drift

# Between two meshes an interval is divided into at most so many parts; each is to be this much better than asked.
_MOST_PARTS, _AHEAD = 8, 2.0


class Goal(NamedTuple):
    """What is asked of meshes.

    - `error`: of every interval, infinite for none;
    - `schemes`: that of the first mesh, then those with more stages that later ones may have.
    """

    error: float
    schemes: tuple[AbstractScheme, ...]


def refinement(
    goal: Goal, scheme: AbstractScheme, drift: Drift
) -> tuple[AbstractScheme, Int[np.ndarray, " intervals"]]:
    """The scheme of the mesh after one that has another, and in how many parts each interval is to be divided."""
    choices = []
    for one in goal.schemes[goal.schemes.index(scheme) :]:
        more = len(one.points) - len(scheme.points)
        expected = drift.with_more(more) * (_AHEAD if more else 1.0)
        needed = parts_of(expected, goal.error, one.estimated_order)
        choices.append((needed.sum() * (len(one.points) - 1), one, needed))
    _, best, parts = min(choices, key=lambda choice: choice[0])
    return best, np.minimum(parts, _MOST_PARTS)


def parts_of(errors: Float[np.ndarray, " intervals"], asked: float, order: int) -> Int[np.ndarray, " intervals"]:
    """In how many parts each interval of a mesh is to be divided, for its error to be what is asked.

    - `order`: by one more, the power of its length by which an interval's states are estimated to err. Between the
      stages of a collocation scheme rates are interpolated, and err by the power of their number.
    """
    needed = np.ceil((_AHEAD * errors / asked) ** (1 / (order + 1))).astype(int)
    return np.where(errors > asked, np.maximum(needed, 2), 1)
