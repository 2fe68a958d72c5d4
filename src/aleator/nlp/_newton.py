"""Newton steps of the interior-point method: the condensed system with slacks and bounds' multipliers around it."""

from typing import NamedTuple, final

import numpy as np

from aleator.nlp._barrier import Iterate, Slacked
from aleator.nlp._condensed import Condensed, IllConditionedError, Matrices
from aleator.nlp._elimination import Elimination
from aleator.nlp._matrices import with_entries
from aleator.nlp._program import Evaluation
from aleator.nlp._scaling import ScaledProgram

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
