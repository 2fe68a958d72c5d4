"""`Box`: one element of the germ's domain, cut out of its probability space."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from aleator.analysis._restricted_germ import restricted
from aleator.uncertainty import AbstractGerm


@final
@dataclass(frozen=True)
class Box:
    """The probability levels of each germ variable between `low` and `high`."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def probability(self) -> float:
        """The probability that the germ lies in the box."""
        return float(np.prod(np.subtract(self.high, self.low)))

    def halves(self, variable: int) -> tuple["Box", "Box"]:
        """Two boxes of equal probability, from a cut across one variable."""
        middle = (self.low[variable] + self.high[variable]) / 2

        def at_middle(ends: tuple[float, ...]) -> tuple[float, ...]:
            return (*ends[:variable], middle, *ends[variable + 1 :])

        return Box(self.low, at_middle(self.high)), Box(at_middle(self.low), self.high)

    def germs(self, germs: Mapping[str, AbstractGerm]) -> dict[str, AbstractGerm]:
        """The distributions of the germ variables, conditional on the box."""
        limits = zip(germs.items(), self.low, self.high, strict=True)
        return {name: restricted(germ, low, high) for (name, germ), low, high in limits}

    def holds(self, levels: Float[np.ndarray, "n variables"]) -> Bool[np.ndarray, " n"]:
        """Which points of the unit cube lie in the box. A face between two boxes belongs to the upper one."""
        low, high = np.array(self.low)[None], np.array(self.high)[None]
        return np.all((levels >= low) & ((levels < high) | (high == 1)), axis=1)
