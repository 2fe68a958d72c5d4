"""`ConstraintResult`: one constraint at a solution."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.nlp import HELD


@final
@dataclass(frozen=True)
class ConstraintResult(Printed):
    """One constraint at a solution, in user units.

    - `values`: values of its expression, one number or one per instant; `times`: the instants (s), None for one number;
    - `multipliers`: the shadow prices, `-d objective / d bound`, in the shape of `values`: positive where the
      upper bound is active, negative where the lower one is;
    - `active`: where it is active, in the shape of `values`;
    - `scale`: its magnitude in its own unit, from its bound and its values near the answer (see `constraint_size` of
      the transcription). It holds if it exceeds its bound by at most a millionth of this.
    """

    name: str
    text: str
    lower: float
    upper: float
    values: Float[np.ndarray, "*shape"]
    times: Float[np.ndarray, " instants"] | None
    multipliers: Float[np.ndarray, "*shape"]
    active: np.ndarray
    scale: float

    @property
    def excess(self) -> Float[np.ndarray, "*shape"]:
        """Excess over the nearer bound; negative where the constraint holds with slack."""
        return np.maximum(self.values - self.upper, self.lower - self.values)

    @property
    def violation(self) -> float:
        """Largest excess over a bound; zero if the constraint holds everywhere."""
        return max(0.0, float(np.max(self.excess)))

    @property
    def holds(self) -> bool:
        """Whether it holds everywhere, to a millionth of its magnitude."""
        return self.violation <= HELD * self.scale

    @property
    def worst_time(self) -> float | None:
        """The instant (s) at which the constraint is closest to, or furthest beyond, its bound."""
        return None if self.times is None else float(self.times[np.argmax(_by_instant(self.excess))])

    @property
    def shadow_price(self) -> float:
        """How much the objective falls for each unit by which the bound is relaxed, summed over its active instants.

        For an equality: how much the objective falls for each unit by which its right-hand side is raised, which may be
        negative.
        """
        if self.lower == self.upper:
            return float(np.sum(self.multipliers))
        return float(np.sum(np.abs(self.multipliers)))

    @property
    def worst(self) -> float:
        """The value that is closest to, or furthest beyond, its bound."""
        return float(self.values.flat[int(np.argmax(self.excess))])

    def sentence(self) -> str:
        """Which constraint is violated, by how much and when, with its text."""
        when = "" if self.worst_time is None else f" at t = {self.worst_time:.4g} s"
        worst = self.worst
        bound, relation = (self.upper, "≤") if worst > self.upper else (self.lower, "≥")
        relation = "=" if self.lower == self.upper else relation
        asked = f"{worst:.6g} where {relation} {bound:.6g} is asked ({self.text})"
        return f"'{self.name}' is violated by {self.violation:.4g}{when}: {asked}"

    def __str__(self) -> str:
        if not self.holds:
            return self.sentence()
        when = "" if self.worst_time is None else f" at t = {self.worst_time:.4g} s"
        if np.any(self.active):
            return f"{self.name}: {self.text}: active{when}, shadow price {self.shadow_price:.4g}"
        return f"{self.name}: {self.text}: slack {-float(np.max(self.excess)):.4g}{when}"


def _by_instant(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).max(axis=1)
