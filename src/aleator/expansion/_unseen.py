"""`Unseen`: the largest corner of the uncertainty without a collocation point, of which an expansion knows nothing.

A spike there, such as a resonance that only the softest spring with the lightest damper meets, moves no coefficient and
no leave-one-out error. How much probability a corner without points holds says how much can hide.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator.expansion._basis import Basis

# Corners that are looked at: all of those of ten variables, and as many of more.
_MOST_CORNERS = 1024

# Variables that a sentence names.
_NAMED = 5


@final
@dataclass(frozen=True)
class Unseen:
    """A corner of the germ's domain that holds no collocation point.

    - `probability`: that a system lies in it; `share`: of each variable's distribution by itself that lies in it;
    - `ends`: at which end of each variable's distribution it lies, "low" or "high".
    """

    probability: float
    share: float
    ends: Mapping[str, str]

    def sentence(self) -> str:
        """Where it is and how much it holds, in words."""
        named = [f"{name} {end}" for name, end in self.ends.items()]
        where = ", ".join(named[:_NAMED]) + (f", ... {len(named)} variables" if len(named) > _NAMED else "")
        each = "" if len(named) == 1 else f", the outermost {100 * self.share:.2g} % of each"
        return f"the largest corner without a point ({where}{each}) holds {100 * self.probability:.2g} % of all systems"


def unseen(basis: Basis, points: Float[np.ndarray, "points variables"]) -> Unseen | None:
    """The most probable corner without a point, cut off at the same level of each variable; None without variables.

    Beyond ten variables only some corners are looked at.
    """
    if basis.variables == 0:
        return None
    levels = np.stack(
        [germ.cumulative(values) for germ, values in zip(basis.germs.values(), np.asarray(points).T, strict=True)],
        axis=1,
    )
    corners = _corners(basis.variables)
    reaches = [_reach(levels, one) for one in corners]
    reach, corner = max(reaches), corners[int(np.argmax(reaches))]
    ends = {name: "high" if high else "low" for name, high in zip(basis.names, corner.tolist(), strict=True)}
    return Unseen(reach**basis.variables, reach, ends)


def _reach(levels: Float[np.ndarray, "points variables"], corner: np.ndarray) -> float:
    """The side of the largest cube at a corner of the unit cube that holds no point."""
    return float(np.where(corner, 1 - levels, levels).max(axis=1).min())


def _corners(variables: int) -> np.ndarray:
    """Corners of the unit cube: True where a variable is high."""
    if 2**variables <= _MOST_CORNERS:
        return np.array([[bool(i >> k & 1) for k in range(variables)] for i in range(2**variables)])
    return np.random.default_rng(0).integers(0, 2, (_MOST_CORNERS, variables)).astype(bool)
