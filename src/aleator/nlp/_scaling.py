"""The program as solvers see it: dimensionless, without fixed decisions and without rows that bind nothing."""

from typing import final

import numpy as np

from aleator.nlp._evaluations import Evaluations
from aleator.nlp._program import Evaluation, NonlinearProgram

# The steepest scaled slope at the start. Solvers begin without curvature, so it is also the length of their first
# step, in typical magnitudes of the decisions.
_FIRST_STEP = 2.0
# A gradient smaller than this fraction of the objective is little more than rounding, and scales nothing.
_ROUNDING = 1e-10
# Below this, a row counts as met when points are ranked, so that the objective decides.
_NEGLIGIBLE_VIOLATION = 1e-7
# Slacks up to this are none, and multipliers up to this are residues of the solver.
_REACHED = 1e-6


@final
class ScaledProgram:
    """The program in `x / decision_scale`, `(f - f(start)) / objective_scale` and `c / constraint_scale`.

    Only free decisions and useful rows are seen: points `z` have shape (n_free,), constraints shape (m_useful,). The
    model is never asked outside the bounds.

    - `size`, `rows`: n_free and m_useful;
    - `structure`: which entries of the Jacobian may be other than zero, shape (m_useful, n_free);
    - `start`: scaled start, clipped to the bounds, shape (n_free,);
    - `lower`, `upper`: scaled bounds, shape (n_free,);
    - `constraint_lower`, `constraint_upper`: scaled bounds, shape (m_useful,);
    - `objective_scale`: from the gradient at the start, so that neither an offset nor a factor of the objective
      matters; from `|f(start)|` where there is no gradient to speak of;
    - `best`: the best point seen, with its evaluation in user units: feasible with the least objective, else the
      least violated one. None before `begin`;
    - `evaluations`: the model behind.
    """

    def __init__(self, program: NonlinearProgram, start: np.ndarray):
        self._program = program
        self._free = program.lower < program.upper
        self._useful = np.isfinite(program.constraint_lower) | np.isfinite(program.constraint_upper)
        self._decision_scale = program.decision_scale[self._free]
        self._constraint_scale = program.constraint_scale[self._useful]
        self._jacobian_factor = self._decision_scale / self._constraint_scale[:, None]
        self._is_whole = bool(self._free.all() and self._useful.all())
        self._fixed_decisions = np.clip(start, program.lower, program.upper)
        self._last: tuple[bytes, Evaluation] | None = None
        self._best_rank = (np.inf, np.inf)

        self.evaluations = Evaluations(program.evaluate, start.size, program.constraint_lower.size)
        self.size, self.rows = int(self._free.sum()), int(self._useful.sum())
        every = np.ones((self._useful.size, self._free.size), dtype=bool)
        structure = every if program.structure is None else program.structure
        self.structure = structure[np.ix_(self._useful, self._free)]
        self.lower = program.lower[self._free] / self._decision_scale
        self.upper = program.upper[self._free] / self._decision_scale
        self.constraint_lower = program.constraint_lower[self._useful] / self._constraint_scale
        self.constraint_upper = program.constraint_upper[self._useful] / self._constraint_scale
        self.start = np.clip(self._fixed_decisions[self._free] / self._decision_scale, self.lower, self.upper)
        self.best: tuple[np.ndarray, Evaluation] | None = None
        self.objective_scale = 1.0
        self._objective_origin = 0.0

    def begin(self) -> None:
        """Evaluate the start and set `objective_scale` from it.

        Raises `NotFiniteError` if the model cannot be evaluated at the start, `HaltedError` if it raised an exception.
        """
        first = self.evaluations.finite_at(self.decisions(self.start))
        gradient = first.gradient[self._free] * self._decision_scale
        steepest = float(np.abs(gradient).max(initial=0.0))
        self._objective_origin = first.objective
        self.objective_scale = max(steepest / _FIRST_STEP, _ROUNDING * abs(first.objective)) or 1.0
        self.evaluate(self.start)

    def rescale(self, z: np.ndarray, objective_scale: float) -> None:
        """Go on from `z`, shape (n_free,), with another scale of the objective.

        Multipliers scale with the inverse of `objective_scale`; those at hand are the caller's to convert.
        """
        self.start = np.clip(z, self.lower, self.upper)
        self.objective_scale = objective_scale
        self._last = None

    def decisions(self, z: np.ndarray) -> np.ndarray:
        """All decisions in user units, shape (n,), within their bounds."""
        x = self._fixed_decisions.copy()
        # The quotient's rounding must not carry a decision past its bound.
        x[self._free] = z * self._decision_scale
        return np.clip(x, self._program.lower, self._program.upper)

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Evaluate `z`, scaled.

        Raises `NotFiniteError` if the model cannot be evaluated here, `HaltedError` if the solve is to end.
        """
        key = np.asarray(z, dtype=float).tobytes()
        if self._last is None or self._last[0] != key or self.evaluations.halt is not None:
            self._last = None
            user = self.evaluations.finite_at(self.decisions(z))
            self._last = (key, self.scale(user))
            self._rank(np.array(z, dtype=float), user, self._last[1])
        return self._last[1]

    def scale(self, user: Evaluation) -> Evaluation:
        """Scale an evaluation in user units: free decisions and useful rows only."""
        jacobian = user.jacobian if self._is_whole else user.jacobian[np.ix_(self._useful, self._free)]
        return Evaluation(
            (user.objective - self._objective_origin) / self.objective_scale,
            user.gradient[self._free] * self._decision_scale / self.objective_scale,
            user.constraints[self._useful] / self._constraint_scale,
            jacobian * self._jacobian_factor,
        )

    def is_finite(self, z: np.ndarray) -> bool:
        """Whether the model can be evaluated at `z`."""
        return self.evaluations.at(self.decisions(z)).is_finite

    def active(
        self, z: np.ndarray, user: Evaluation, rows: np.ndarray, bounds: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which of all constraints, shape (m,), and of all decisions' bounds, shape (n,), hold the point where it is.

        `rows` and `bounds` are the scaled multipliers at `z`.
        """
        constraints = user.constraints[self._useful] / self._constraint_scale
        all_rows, all_bounds = np.zeros(self._useful.size, dtype=bool), np.ones(self._free.size, dtype=bool)
        all_rows[self._useful] = _holding(constraints, self.constraint_lower, self.constraint_upper, rows)
        all_bounds[self._free] = _holding(z, self.lower, self.upper, bounds)
        return all_rows, all_bounds

    def violation(self, constraints: np.ndarray) -> np.ndarray:
        """How far each scaled constraint is outside its bounds, negative inside; shape (m_useful,)."""
        return np.maximum(constraints - self.constraint_upper, self.constraint_lower - constraints)

    def multipliers_to_user(self, multipliers: np.ndarray) -> np.ndarray:
        """Multipliers of all rows in user units, shape (m,), from scaled ones of the useful rows."""
        user = np.zeros(self._useful.size)
        user[self._useful] = multipliers * self.objective_scale / self._constraint_scale
        return user

    def multipliers_to_scaled(self, multipliers: np.ndarray) -> np.ndarray:
        """Invert `multipliers_to_user`, shape (m_useful,)."""
        return multipliers[self._useful] * self._constraint_scale / self.objective_scale

    def bound_multipliers_to_user(
        self, bound_multipliers: np.ndarray, multipliers: np.ndarray, user: Evaluation
    ) -> np.ndarray:
        """Multipliers of all bounds, shape (n,), from scaled ones of the free decisions.

        Those of fixed decisions make the Lagrangian stationary, given the `multipliers` of all rows in user units.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            # A model that is not finite leaves no multipliers to speak of, and nothing to warn about.
            complete = -(user.gradient + multipliers @ user.jacobian)
        complete[self._free] = bound_multipliers * self.objective_scale / self._decision_scale
        return complete

    def _rank(self, z: np.ndarray, user: Evaluation, scaled: Evaluation) -> None:
        violation = float(self.violation(scaled.constraints).max(initial=0.0))
        rank = (violation if violation > _NEGLIGIBLE_VIOLATION else 0.0, user.objective)
        if rank < self._best_rank:
            self._best_rank = rank
            self.best = (z, user)


def _holding(values: np.ndarray, lower: np.ndarray, upper: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
    """A bound holds a value that has reached it, or that an interior point keeps off it by less than it pushes."""
    with np.errstate(invalid="ignore"):
        reached = np.minimum(values - lower, upper - values) <= _REACHED
        slack = np.abs(np.where(multipliers > 0, upper - values, values - lower))
        return reached | (lower == upper) | ((np.abs(multipliers) > _REACHED) & (np.abs(multipliers) > slack))
