"""The program as solvers see it: dimensionless, without fixed variables and without unbounded rows."""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import scipy

from aleator.nlp._evaluations import (
    MOST_DIFFERENCED,
    Evaluations,
    NotFiniteError,
    Straightness,
    changes_of,
)
from aleator.nlp._matrices import Block, Matrix, checked_sparse
from aleator.nlp._program import Evaluation, Magnitudes, NonlinearProgram


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


# The steepest scaled slope at the start. Solvers begin without curvature, so it is also the length of their first
# step, in typical magnitudes of the variables.
_FIRST_STEP = 2.0
# A gradient smaller than this fraction of the objective is little more than rounding, and not used for scaling.
_ROUNDING = 1e-10
# Violations below this count as none when points are ranked, so that the objective decides.
_NEGLIGIBLE_VIOLATION = 1e-7
# Slacks and multipliers up to this count as zero; the latter are residues of the solver.
_REACHED = 1e-6


@final
class ScaledProgram:
    """The program in `x / variable_scale`, `(f - f(start)) / objective_scale` and `c / constraint_scale`.

    A solver sees it in scales that suit its steps; an answer is judged in those of its own magnitudes (`rescale`).

    It has only free variables and useful rows: points `z` have shape (n_free,), constraints shape (m_useful,). The
    model is never evaluated outside the bounds.

    - `size`, `rows`: n_free and m_useful; `useful`: which of the constraints these are, shape (m,);
    - `sparsity`: the entries of the Jacobian that may be nonzero, shape (m_useful, n_free), dense or sparse as the
      Jacobians are; `curved`: those of the Hessian's lower triangle, None if there is no Hessian
      (`take_differences` makes one);
    - `straightness`: whether all slopes seen so far were the same;
    - `start`: scaled start, clipped to the bounds, shape (n_free,);
    - `lower`, `upper`: scaled bounds, shape (n_free,);
    - `constraint_lower`, `constraint_upper`: scaled bounds, shape (m_useful,);
    - `objective_scale`: from the gradient at the start, so that neither an offset nor a factor of the objective
      matters; from `|f(start)|` if the gradient is negligible;
    - `best`: the best point seen, with its evaluation in user units: feasible with the least objective, else the
      least violated one. None before `begin`;
    - `evaluations`: of the user's model;
    - `visited`: objective, in user units, and largest scaled violation of every point at which it was evaluated.
    """

    def __init__(self, program: NonlinearProgram, start: np.ndarray):
        self._program = program
        self._free = program.lower < program.upper
        self.useful = np.isfinite(program.constraint_lower) | np.isfinite(program.constraint_upper)
        self._variable_scale = program.variable_scale[self._free]
        self._is_whole = bool(self._free.all() and self.useful.all())
        self._fixed_variables = np.clip(start, program.lower, program.upper)
        self._last: tuple[bytes, Evaluation] | None = None
        self._best_rank = (np.inf, np.inf)

        self.evaluations = Evaluations(program.evaluate, start.size, program.constraint_lower.size, program.sparsity)
        self.size, self.rows = int(self._free.sum()), int(self.useful.sum())
        self._block = self._hessian_block = None
        if program.sparsity is None or isinstance(program.sparsity, np.ndarray):
            every = np.ones((self.useful.size, self._free.size), dtype=bool)
            sparsity = every if program.sparsity is None else program.sparsity
            self.sparsity: Matrix = sparsity[np.ix_(self.useful, self._free)]
        else:
            self._block = Block(program.sparsity, self.useful, self._free)
            self.sparsity = self._block.sparsity
        if program.hessian is not None:
            self._hessian_block = Block(program.hessian.sparsity, self._free, self._free)
            self._hessian_factor = self._hessian_block.factors(self._variable_scale, self._variable_scale)
        self.curved = None if self._hessian_block is None else self._hessian_block.sparsity
        self.lower = program.lower[self._free] / self._variable_scale
        self.upper = program.upper[self._free] / self._variable_scale
        self.start = np.clip(self._fixed_variables[self._free] / self._variable_scale, self.lower, self.upper)
        self.best: tuple[np.ndarray, Evaluation] | None = None
        self.visited: list[tuple[float, float]] = []
        self.straightness = Straightness()
        self._by_differences = False
        self.objective_scale = 1.0
        self._objective_origin = 0.0
        self._scale_constraints(program.constraint_scale[self.useful])

    def begin(self) -> None:
        """Evaluate the start and set `objective_scale` from it.

        Raises `NotFiniteError` if the model cannot be evaluated at the start, `HaltedError` if it raised an exception.
        """
        first = self.evaluations.finite_at(self.unscaled(self.start))
        gradient = first.gradient[self._free] * self._variable_scale
        steepest = float(np.abs(gradient).max(initial=0.0))
        self._objective_origin = first.objective
        self.objective_scale = max(steepest / _FIRST_STEP, _ROUNDING * abs(first.objective)) or 1.0
        self.evaluate(self.start)

    @property
    def start_objective(self) -> float:
        """The size of the objective at the first start, scaled."""
        return abs(self._objective_origin) / self.objective_scale

    @property
    def scales(self) -> Scales:
        """The current scales."""
        return Scales(self.objective_scale, self._constraint_scale)

    def rescale(self, z: np.ndarray, scales: Scales) -> None:
        """Continue from `z`, shape (n_free,), in other scales. The caller must convert its multipliers."""
        self.start = np.clip(z, self.lower, self.upper)
        self.objective_scale = scales.objective
        self._scale_constraints(scales.constraints)
        self._last = None
        if self.best is not None:
            # In other scales another point may be the least violated.
            (point, user), self._best_rank = self.best, (np.inf, np.inf)
            self._rank(point, user, self.scale(user))

    def _scale_constraints(self, scale: np.ndarray) -> None:
        self._constraint_scale = scale
        if self._block is None:
            self._jacobian_factor = self._variable_scale / scale[:, None]
        else:
            self._jacobian_factor = self._block.factors(1 / scale, self._variable_scale)
        self.constraint_lower = self._program.constraint_lower[self.useful] / scale
        self.constraint_upper = self._program.constraint_upper[self.useful] / scale

    def magnitudes(self, user: Evaluation, z: np.ndarray) -> Magnitudes:
        """Magnitudes of the useful constraints at `z` with its evaluation in user units, shape (m_useful,) each."""
        if self._program.magnitudes is None:
            scale = self._program.constraint_scale[self.useful]
            return Magnitudes(scale, scale)
        size, scale = self._program.magnitudes(self.unscaled(z), user)
        return Magnitudes(size[self.useful], scale[self.useful])

    def sizes(self, useful: np.ndarray) -> np.ndarray:
        """Sizes of all constraints, shape (m,), from those of the useful ones."""
        sizes = self._program.constraint_scale.copy()
        sizes[self.useful] = useful
        return sizes

    def above_least(self, user: Evaluation) -> float:
        """The objective's distance from its lower bound, over its change over a typical magnitude of the variables.

        Infinite if no lower bound is known.
        """
        change = float(np.abs(user.gradient[self._free] * self._variable_scale).sum())
        return max(user.objective - self._program.least, 0.0) / change if change > 0 else np.inf

    def unscaled(self, z: np.ndarray) -> np.ndarray:
        """All variables in user units, shape (n,), within their bounds."""
        x = self._fixed_variables.copy()
        # Rounding of the quotient must not carry a variable past its bound.
        x[self._free] = z * self._variable_scale
        return np.clip(x, self._program.lower, self._program.upper)

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Evaluate `z`, scaled.

        Raises `NotFiniteError` if the model cannot be evaluated here, `HaltedError` if the solve must end.
        """
        key = np.asarray(z, dtype=float).tobytes()
        if self._last is None or self._last[0] != key or self.evaluations.halt is not None:
            self._last = None
            try:
                user = self.evaluations.finite_at(self.unscaled(z))
            except NotFiniteError:
                self._note(np.nan, np.nan)
                raise
            self.straightness.note(np.array(z, dtype=float), user)
            self._last = (key, self.scale(user))
            violation = self._rank(np.array(z, dtype=float), user, self._last[1])
            self._note(user.objective, violation)
        return self._last[1]

    def _note(self, objective: float, violation: float) -> None:
        """Keep what a point gave unless it had been evaluated before."""
        self.visited += [(objective, violation)] * (self.evaluations.count - len(self.visited))

    def scale(self, user: Evaluation) -> Evaluation:
        """Scale an evaluation in user units: free variables and useful rows only."""
        return Evaluation(
            (user.objective - self._objective_origin) / self.objective_scale,
            user.gradient[self._free] * self._variable_scale / self.objective_scale,
            user.constraints[self.useful] / self._constraint_scale,
            self._scaled_jacobian(user.jacobian),
        )

    def _scaled_jacobian(self, jacobian: Matrix) -> Matrix:
        if self._block is not None:
            return self._block.of(jacobian, self._jacobian_factor)
        return (jacobian if self._is_whole else jacobian[np.ix_(self.useful, self._free)]) * self._jacobian_factor

    def hessian(self, z: np.ndarray, weight: float, multipliers: np.ndarray) -> np.ndarray:
        """The entries of the scaled Hessian's lower triangle in the order of `curved`, shape (entries,).

        `weight` is that of the scaled objective, `multipliers` those of the useful scaled rows. Raises `NotFiniteError`
        if some entries are not finite, `HaltedError` if the solve must end.
        """
        if self._by_differences:
            return self._differenced(z, weight, multipliers)
        program = self._program
        assert program.hessian is not None
        assert self._hessian_block is not None
        rows = np.zeros(self.useful.size)
        rows[self.useful] = multipliers / self._constraint_scale
        given = self.unscaled(z), weight / self.objective_scale, rows
        found = self.evaluations.asked(lambda: program.hessian.evaluate(*given))  # type: ignore[union-attr]
        whole = checked_sparse("Hessian", found, program.hessian.sparsity)
        numbers = self._hessian_block.of(whole, self._hessian_factor).data
        if not np.isfinite(numbers).all():
            raise NotFiniteError
        return numbers

    @property
    def can_take_differences(self) -> bool:
        """Whether there is no Hessian, but could be one by differences: of few variables, or if nothing curves."""
        return self.curved is None and (self.size <= MOST_DIFFERENCED or self.straightness.is_shown)

    def take_differences(self) -> bool:
        """Have a Hessian by differences of slopes from now on, zero as long as these were the same everywhere.

        Returns whether that is new, and possible.
        """
        if not self.can_take_differences:
            return False
        # Where differences would take too long nothing curves: the diagonal, of zeros, will do.
        few = self.size <= MOST_DIFFERENCED
        lower = np.tril(np.ones((self.size, self.size))) if few else scipy.sparse.eye_array(self.size)
        self.curved = scipy.sparse.csr_array(lower)
        self._by_differences = True
        return True

    def _differenced(self, z: np.ndarray, weight: float, multipliers: np.ndarray) -> np.ndarray:
        assert self.curved is not None
        if self.straightness.is_shown or self.size > MOST_DIFFERENCED:
            return np.zeros(self.curved.nnz)

        def slope(point: np.ndarray) -> np.ndarray:
            found = self.evaluate(point)
            return weight * found.gradient + multipliers @ found.jacobian

        z = np.array(z, dtype=float)
        size = np.maximum(1.0, np.abs(z))
        columns = changes_of(slope, z, (self.lower, self.upper), np.diag(size)) / size
        return ((columns + columns.T) / 2)[np.tril_indices(self.size)]

    def objective_size(self, evaluation: Evaluation) -> float:
        """The scaled magnitude of the objective, with the offset that a scaled evaluation lacks."""
        return abs(evaluation.objective + self._objective_origin / self.objective_scale)

    def terms(self, evaluation: Evaluation, multipliers: Multipliers) -> float:
        """The scaled magnitude of the terms of the Lagrangian, here and at the start, to which rounding is relative."""
        objective = self.objective_size(evaluation) + self.start_objective
        return objective + float(np.abs(multipliers.rows) @ np.abs(evaluation.constraints))

    def is_finite(self, z: np.ndarray) -> bool:
        """Whether the model can be evaluated at `z`."""
        return self.evaluations.at(self.unscaled(z)).is_finite

    def active(
        self, z: np.ndarray, user: Evaluation, rows: np.ndarray, bounds: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The active constraints, shape (m,), and the active bounds of variables, shape (n,), as truth values.

        `rows` and `bounds` are the scaled multipliers at `z`.
        """
        constraints = user.constraints[self.useful] / self._constraint_scale
        all_rows, all_bounds = np.zeros(self.useful.size, dtype=bool), np.ones(self._free.size, dtype=bool)
        all_rows[self.useful] = _holding(constraints, self.constraint_lower, self.constraint_upper, rows)
        all_bounds[self._free] = _holding(z, self.lower, self.upper, bounds)
        return all_rows, all_bounds

    def violation(self, constraints: np.ndarray) -> np.ndarray:
        """How far each scaled constraint is outside its bounds, negative inside; shape (m_useful,)."""
        return np.maximum(constraints - self.constraint_upper, self.constraint_lower - constraints)

    def multipliers_to_user(self, multipliers: np.ndarray) -> np.ndarray:
        """Multipliers of all rows in user units, shape (m,), from scaled ones of the useful rows."""
        user = np.zeros(self.useful.size)
        user[self.useful] = multipliers * self.objective_scale / self._constraint_scale
        return user

    def multipliers_to_scaled(self, multipliers: np.ndarray) -> np.ndarray:
        """Invert `multipliers_to_user`, shape (m_useful,)."""
        return multipliers[self.useful] * self._constraint_scale / self.objective_scale

    def bound_multipliers_to_user(
        self, bound_multipliers: np.ndarray, multipliers: np.ndarray, user: Evaluation
    ) -> np.ndarray:
        """Multipliers of all bounds, shape (n,), from scaled ones of the free variables.

        Those of fixed variables make the Lagrangian stationary, given the `multipliers` of all rows in user units.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            # If the model is not finite, the multipliers are meaningless, and no warning is needed.
            complete = -(user.gradient + multipliers @ user.jacobian)
        complete[self._free] = bound_multipliers * self.objective_scale / self._variable_scale
        return complete

    def _rank(self, z: np.ndarray, user: Evaluation, scaled: Evaluation) -> float:
        """Keep a point if it is the best so far. Returns its largest violation, scaled."""
        violation = float(self.violation(scaled.constraints).max(initial=0.0))
        rank = (violation if violation > _NEGLIGIBLE_VIOLATION else 0.0, user.objective)
        if rank < self._best_rank:
            self._best_rank = rank
            self.best = (z, user)
        return violation


def _holding(values: np.ndarray, lower: np.ndarray, upper: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
    """Whether a value is at its bound, or, from an interior point, nearer to it than the size of its multiplier."""
    with np.errstate(invalid="ignore"):
        reached = np.minimum(values - lower, upper - values) <= _REACHED
        slack = np.abs(np.where(multipliers > 0, upper - values, values - lower))
        return reached | (lower == upper) | ((np.abs(multipliers) > _REACHED) & (np.abs(multipliers) > slack))
