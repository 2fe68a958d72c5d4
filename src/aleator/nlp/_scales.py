"""Multipliers, and the scales of objective and constraints in which they are."""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np


@final
@dataclass(frozen=True)
class Multipliers:
    """Scaled multipliers: of the rows, shape (m_useful,), and of the free variables' bounds, shape (n_free,)."""

    rows: np.ndarray
    bounds: np.ndarray


class Scales(NamedTuple):
    """The divisors of the objective and of the useful constraints, shape (m_useful,)."""

    objective: float
    constraints: np.ndarray

    def converted(self, multipliers: Multipliers | None, into: "Scales") -> Multipliers | None:
        """Multipliers converted into other scales."""
        if multipliers is None:
            return None
        ratio = self.objective / into.objective
        rows = multipliers.rows * ratio * (into.constraints / self.constraints)
        return Multipliers(rows, multipliers.bounds * ratio)

    def is_near(self, other: "Scales", factor: float) -> bool:
        """Whether no scale differs from the other's by more than a factor."""
        objective, rows = self.objective / other.objective, self.constraints / other.constraints
        return bool(1 / factor <= objective <= factor and np.all((rows <= factor) & (rows >= 1 / factor)))
