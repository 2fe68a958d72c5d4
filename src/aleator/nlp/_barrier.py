"""The parts of a primal-dual interior-point method (Wächter and Biegler 2006): the filter of its line search (section
2.3), variables and slacks within bounds, and Newton steps by the condensed system.
"""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from aleator.nlp._elimination import Condensed, Elimination, IllConditionedError, Matrices
from aleator.nlp._matrices import with_entries
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import ScaledProgram

# Names of the source in brackets.
_LESS_VIOLATION, _LESS_OBJECTIVE = 1e-5, 1e-8  # γ_θ, γ_φ
_ARMIJO = 1e-8  # η_φ
_SWITCH_OBJECTIVE, _SWITCH_VIOLATION = 2.3, 1.1  # s_φ, s_θ
_SHORTEST = 0.05  # γ_α
_LARGEST, _SMALL = 1e4, 1e-4  # θ_max, θ_min over that of the start
_ROUNDINGS = 10 * float(np.finfo(float).eps)


@final
class Filter:
    """Decides which trial points are accepted.

    - `start`: the violation at the start of the search, in the sum of rows.
    """

    def __init__(self, start: float):
        self._largest, self._small = _LARGEST * max(1.0, start), _SMALL * max(1.0, start)
        self._pairs: list[tuple[float, float]] = []

    def clear(self) -> None:
        """Forget all pairs: the objective is another one."""
        self._pairs.clear()

    def shortest(self, violation: float, descent: float) -> float:
        """The step below which there is no hope; `descent`: the slope of the objective along the step."""
        found = _LESS_VIOLATION
        if descent < 0:
            found = min(found, _LESS_OBJECTIVE * violation / -descent)
            if violation <= self._small:
                found = min(found, violation**_SWITCH_VIOLATION / (-descent) ** _SWITCH_OBJECTIVE)
        return max(_SHORTEST * found, _ROUNDINGS)

    def accepts(self, before: tuple[float, float], after: tuple[float, float], descent: float, length: float) -> bool:
        """Whether a trial point is accepted; the pair before it then joins the filter unless the objective falls."""
        (violation, objective), (there, then) = before, after
        slack = _ROUNDINGS * abs(objective)
        if not there <= self._largest or not np.isfinite(then):
            return False
        if any(there >= one and then - other > slack for one, other in self._pairs):
            return False
        falls = descent < 0 and length * (-descent) ** _SWITCH_OBJECTIVE > violation**_SWITCH_VIOLATION
        if falls and violation <= self._small:
            return then - objective - _ARMIJO * length * descent <= slack
        less = there <= (1 - _LESS_VIOLATION) * violation
        if not less and then - objective + _LESS_OBJECTIVE * violation > slack:
            return False
        if not (falls and then - objective - _ARMIJO * length * descent <= slack):
            self._pairs.append(((1 - _LESS_VIOLATION) * violation, objective - _LESS_OBJECTIVE * violation))
        return True


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


# Names of the source, Wächter and Biegler 2006, in brackets.
_FIRST_SHIFT, _LEAST_SHIFT, _MOST_SHIFT = 1e-4, 1e-20, 1e20  # δ_w
_FIRST_GROWTH, _GROWTH, _DECAY = 100.0, 8.0, 3.0  # κ_w
_ROW_SHIFT, _ROW_SHIFT_POWER = 1e-8, 0.25  # δ_c
_LARGEST_FIRST_MULTIPLIER = 1e3


@final
class Newton(NamedTuple):
    """The conditions, linearised at an iterate.

    - `weight`: of the barrier; `stiffness`: second derivatives of the barrier, shape (n + inequalities,);
    - `shift`: what was added to the curvature, 0 if nothing.
    """

    slacked: Slacked
    at: Iterate
    evaluation: Evaluation
    weight: float
    stiffness: np.ndarray
    system: Condensed
    shift: float

    @classmethod
    def of(
        cls,
        scaled: ScaledProgram,
        elimination: Elimination,
        slacked: Slacked,
        at: Iterate,
        evaluation: Evaluation,
        weight: float,
        last_shift: float,
    ) -> "Newton":
        """At an iterate, regularised until its curvature is that of a minimum.

        `last_shift`: the latest that was needed, 0 if none was. Raises `IllConditionedError` if no shift is enough.
        """
        below, above = slacked.gaps(at.values)
        stiffness = at.below / below + at.above / above
        assert scaled.curved is not None
        curved = with_entries(scaled.curved, scaled.hessian(at.values[: slacked.size], 1.0, at.rows))
        softness = np.zeros(scaled.rows)
        softness[slacked.unequal] = 1 / stiffness[slacked.size :]
        matrices = Matrices(curved, stiffness[: slacked.size], evaluation.jacobian, softness)
        system = Condensed(elimination, matrices)
        shift = _regularised(system, weight, last_shift)
        return cls(slacked, at, evaluation, weight, stiffness, system, shift)

    @property
    def missed(self) -> np.ndarray:
        """What the rows miss, shape (m,)."""
        return self.slacked.residual(self.at.values, self.evaluation)

    @property
    def barred(self) -> np.ndarray:
        """The gradient of the objective with its barrier, shape (n + inequalities,)."""
        below, above = self.slacked.gaps(self.at.values)
        bare = np.append(self.evaluation.gradient, np.zeros(self.slacked.unequal.size))
        return bare - self.weight / below + self.weight / above

    def step(self, missed: np.ndarray) -> Iterate:
        """The step of all variables, slacks and multipliers, for rows that miss so much.

        Raises `IllConditionedError` if it cannot be computed to a few digits.
        """
        slacked, at, weight = self.slacked, self.at, self.weight
        below, above = slacked.gaps(at.values)
        pull = -(slacked.slope(at, self.evaluation) - weight / below + weight / above)
        by_slacks, stiffness = pull[slacked.size :], self.stiffness[slacked.size :]
        rows = -missed
        rows[slacked.unequal] += by_slacks / stiffness
        moved, more = self.system.solve(pull[: slacked.size], rows)
        values = np.append(moved, (by_slacks + more[slacked.unequal]) / stiffness)
        return Iterate(
            values,
            more,
            (weight - at.below * values) / below - at.below,
            (weight + at.above * values) / above - at.above,
        )


def _regularised(system: Condensed, weight: float, last: float) -> float:
    """The shift of the curvature that a system has from now on (algorithm IC of the source)."""
    positive, negative = system.regularise(0.0, 0.0)
    rows = _ROW_SHIFT * weight**_ROW_SHIFT_POWER if negative > 0 else 0.0
    if rows:
        positive, negative = system.regularise(0.0, rows)
    shift = 0.0
    while positive > 0 or negative > 0:
        if shift:
            shift *= _GROWTH if last else _FIRST_GROWTH
        else:
            shift = max(_LEAST_SHIFT, last / _DECAY) if last else _FIRST_SHIFT
        if shift > _MOST_SHIFT:
            raise IllConditionedError
        positive, negative = system.regularise(shift, rows)
    return shift


def first_multipliers(
    scaled: ScaledProgram, elimination: Elimination, slacked: Slacked, at: Iterate, evaluation: Evaluation
) -> np.ndarray:
    """Multipliers of the rows that come closest to a stationary start, shape (m,); zero if they are large."""
    pull = -slacked.slope(at, evaluation) + at.below - at.above
    none, softness, rows = np.zeros(scaled.rows), np.zeros(scaled.rows), np.zeros(scaled.rows)
    softness[slacked.unequal] = 1.0
    rows[slacked.unequal] = pull[slacked.size :]
    assert scaled.curved is not None
    flat = with_entries(scaled.curved, np.zeros(scaled.curved.nnz))
    system = Condensed(elimination, Matrices(flat, np.ones(scaled.size), evaluation.jacobian, softness))
    if system.regularise(0.0, 0.0) != (0, 0):
        return none
    try:
        _, found = system.solve(pull[: slacked.size], rows)
    except IllConditionedError:
        return none
    return found if np.abs(found).max(initial=0.0) <= _LARGEST_FIRST_MULTIPLIER else none
