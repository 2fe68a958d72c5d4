"""Variables and slacks within bounds, as a primal-dual interior-point method sees them (Wächter and Biegler 2006)."""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import ScaledProgram

# The multiplier of a bound stays within this factor of what its gap and the barrier ask.
_CONSISTENT = 1e10
# A gap may be lost in rounding, although a step never uses it up.
_LEAST_GAP = 1e-15
# Multipliers up to this size leave the residuals as they are.
_USUAL_MULTIPLIER = 100.0


class Iterate(NamedTuple):
    """A point with its multipliers.

    - `values`: the variables, then the slacks of the inequalities, shape (n + inequalities,);
    - `rows`: multipliers, shape (m,); `below`, `above`: those of the bounds, not negative, shape (n + inequalities,).
    """

    values: np.ndarray
    rows: np.ndarray
    below: np.ndarray
    above: np.ndarray


@final
@dataclass(frozen=True)
class Slacked:
    """A scaled program whose inequalities have slacks: equalities and bounds alone.

    - `size`: of the variables; `unequal`: the rows that are inequalities; `lower`, `upper`: the bounds of variables,
      then slacks; `equal_to`: the bound of each equality, else 0, shape (m,).
    """

    size: int
    unequal: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    equal_to: np.ndarray

    @classmethod
    def of(cls, scaled: ScaledProgram) -> "Slacked":
        """That of a program."""
        unequal = np.flatnonzero(scaled.constraint_lower < scaled.constraint_upper)
        return cls(
            scaled.size,
            unequal,
            np.append(scaled.lower, scaled.constraint_lower[unequal]),
            np.append(scaled.upper, scaled.constraint_upper[unequal]),
            np.where(scaled.constraint_lower < scaled.constraint_upper, 0.0, scaled.constraint_lower),
        )

    def pushed(self, values: np.ndarray, push: float) -> np.ndarray:
        """Values inside their bounds: at least by `push` of their size and of the distance of the bounds."""
        with np.errstate(invalid="ignore"):
            width = push * (self.upper - self.lower)
            low = self.lower + np.minimum(push * np.maximum(1.0, np.abs(self.lower)), width)
            high = self.upper - np.minimum(push * np.maximum(1.0, np.abs(self.upper)), width)
        low, high = np.where(np.isfinite(self.lower), low, -np.inf), np.where(np.isfinite(self.upper), high, np.inf)
        return np.clip(values, low, high)

    def gaps(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The distances from the lower and upper bounds; infinite where there is none."""
        return np.maximum(values - self.lower, _LEAST_GAP), np.maximum(self.upper - values, _LEAST_GAP)

    def residual(self, values: np.ndarray, evaluation: Evaluation) -> np.ndarray:
        """What the rows miss, shape (m,)."""
        missed = evaluation.constraints - self.equal_to
        missed[self.unequal] -= values[self.size :]
        return missed

    def slope(self, at: Iterate, evaluation: Evaluation) -> np.ndarray:
        """The gradient of the objective and of the rows, weighted by their multipliers, by variables and slacks."""
        return np.append(evaluation.gradient + evaluation.jacobian.T @ at.rows, -at.rows[self.unequal])

    def barrier(self, values: np.ndarray, evaluation: Evaluation, weight: float) -> float:
        """The objective with its barrier."""
        gaps = np.concatenate(self.gaps(values))
        return evaluation.objective - weight * float(np.log(gaps[np.isfinite(gaps)]).sum())

    def error(self, at: Iterate, evaluation: Evaluation, weight: float) -> float:
        """The largest residual of the conditions with that weight of the barrier (equation 5 of the source)."""
        dual = self.slope(at, evaluation) - at.below + at.above
        both = np.concatenate([at.below, at.above])
        gaps = np.concatenate(self.gaps(at.values))
        bounded = np.isfinite(gaps)
        products = (gaps[bounded] * both[bounded]) - weight
        total, count = float(np.abs(both).sum()), max(int(bounded.sum()), 1)
        every = (total + float(np.abs(at.rows).sum())) / (count + at.rows.size)
        by, by_products = (max(_USUAL_MULTIPLIER, mean) / _USUAL_MULTIPLIER for mean in (every, total / count))
        return max(
            _largest(dual) / by, _largest(self.residual(at.values, evaluation)), _largest(products) / by_products
        )

    def longest(self, values: np.ndarray, step: np.ndarray, fraction: float) -> float:
        """The longest step, at most 1, that leaves some of every gap."""
        below, above = self.gaps(values)
        return min(_longest(below, step, fraction), _longest(above, -step, fraction))

    def moved(self, at: Iterate, by: Iterate, length: float, weight: float, fraction: float) -> Iterate:
        """The next iterate: a step of that length, and of the bounds' multipliers as far as they may go."""
        values = at.values + length * by.values
        dual = min(_longest(at.below, by.below, fraction), _longest(at.above, by.above, fraction))
        gaps = self.gaps(values)
        both = at.below + dual * by.below, at.above + dual * by.above
        below, above = (_consistent(one, gap, weight) for one, gap in zip(both, gaps, strict=True))
        return Iterate(values, at.rows + length * by.rows, below, above)


def _longest(gap: np.ndarray, change: np.ndarray, fraction: float) -> float:
    closing = (change < 0) & np.isfinite(gap)
    return min(1.0, float((-fraction * gap[closing] / change[closing]).min(initial=1.0)))


def _consistent(multipliers: np.ndarray, gap: np.ndarray, weight: float) -> np.ndarray:
    target = weight / gap
    return np.clip(multipliers, target / _CONSISTENT, target * _CONSISTENT)


def _largest(numbers: np.ndarray) -> float:
    return float(np.abs(numbers).max(initial=0.0))
