"""`Unseen`: the largest corner of the germ space without a collocation point, about which an expansion knows nothing.

A spike there, such as a resonance that only the softest spring with the lightest damper meets, changes no coefficient
and no leave-one-out error. The probability of such a corner shows how much can be missed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.expansion._basis import Basis

# Corners that are checked: all those of up to ten variables, and at most as many of more variables.
_MOST_CORNERS = 1024

# Most variables that a sentence names.
_NAMED = 5


@final
@dataclass(frozen=True)
class Unseen(Printed):
    """A corner of the germ's domain that holds no collocation point.

    - `probability`: that a system lies in it; `share`: the part of each variable's own distribution that it covers;
    - `ends`: the end of each variable's distribution at which it lies, "low" or "high".
    """

    probability: float
    share: float
    ends: Mapping[str, str]

    def sentence(self) -> str:
        """Its place and its probability in words."""
        named = [f"{name} {end}" for name, end in self.ends.items()]
        where = ", ".join(named[:_NAMED]) + (f", ... {len(named)} variables" if len(named) > _NAMED else "")
        each = "" if len(named) == 1 else f", the outermost {100 * self.share:.2g} % of each"
        return f"the largest corner without a point ({where}{each}) holds {100 * self.probability:.2g} % of all systems"

    def __str__(self) -> str:
        return self.sentence()


def unseen(basis: Basis, points: Float[np.ndarray, "points variables"]) -> Unseen | None:
    """The most probable corner without a point, with the same level for each variable; None without variables.

    Beyond ten variables only some corners are checked.
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
    """The side of the largest cube without points at a corner of the unit cube."""
    return float(np.where(corner, 1 - levels, levels).max(axis=1).min())


def _corners(variables: int) -> np.ndarray:
    """Corners of the unit cube: True where a variable is high."""
    if 2**variables <= _MOST_CORNERS:
        return np.array([[bool(i >> k & 1) for k in range(variables)] for i in range(2**variables)])
    return np.random.default_rng(0).integers(0, 2, (_MOST_CORNERS, variables)).astype(bool)
