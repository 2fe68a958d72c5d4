"""The program as solvers see it: dimensionless, without fixed variables and without unbounded rows."""

import contextlib
from typing import NamedTuple, final

import numpy as np
import scipy

from aleator.nlp._evaluations import Evaluations, NotFiniteError
from aleator.nlp._matrices import Block, Matrix, SparseMatrix, checked_sparse, entries
from aleator.nlp._program import Evaluation, NonlinearProgram, Sides


class Multipliers(NamedTuple):
    """Scaled multipliers: of the rows, shape (m_useful,), and of the free variables' bounds, shape (n_free,)."""

    rows: np.ndarray
    bounds: np.ndarray

    @property
    def every(self) -> np.ndarray:
        """Those of the rows, then those of the bounds, shape (m_useful + n_free,)."""
        return np.concatenate([self.rows, self.bounds])

    def kept(self, which: np.ndarray) -> "Multipliers":
        """Some of them, by truth values in the order of `every`, and zeros for the others."""
        return Multipliers(*np.split(np.where(which, self.every, 0.0), [self.rows.size]))

    def slope(self, evaluation: Evaluation, weight: float = 1.0) -> np.ndarray:
        """The gradient `w ∇f + Jᵀλ + μ` of the Lagrangian with a scaled evaluation, shape (n_free,)."""
        return weight * evaluation.gradient + self.rows @ evaluation.jacobian + self.bounds


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


# The steepest scaled slope at the start. Solvers begin without curvature, so it is also the length of their first
# step, in typical magnitudes of the variables.
_FIRST_STEP = 2.0
# A gradient smaller than this fraction of the objective is little more than rounding, and not used for scaling.
_ROUNDING = 1e-10
# Violations below this count as none when points are ranked, so that the objective decides.
_NEGLIGIBLE_VIOLATION = 1e-7
# Slacks and multipliers up to this count as zero; the latter are residues of the solver.
_REACHED = 1e-6
# Most variables for which second derivatives are taken from differences of first ones, two evaluations for each; and
# the length of a step in sizes of the variables.
MOST_DIFFERENCED, _STEP = 30, 1e-4


@final
class ScaledProgram:
    """The program in `x / variable_scale`, `(f - f(start)) / objective_scale` and `c / constraint_scale`.

    A solver sees it in scales that suit its steps; an answer is judged in those of its own magnitudes (`rescale`).

    It has only free variables and useful rows: points `z` have shape (n_free,), constraints shape (m_useful,). The
    model is never evaluated outside the bounds.

    - `program`: the user's;
    - `size`, `rows`: n_free and m_useful; `useful`: which of the constraints these are, shape (m,);
    - `sparsity`: the entries of the Jacobian that may be nonzero, shape (m_useful, n_free), dense or sparse as the
      Jacobians are; `curved`: those of the Hessian's lower triangle, None if there is no Hessian
      (`take_differences` makes one);
    - `start`: scaled start, clipped to the bounds, shape (n_free,);
    - `lower`, `upper`: scaled bounds, shape (n_free,);
    - `constraint_lower`, `constraint_upper`: scaled bounds, shape (m_useful,);
    - `scales`: the current ones. That of the objective is from its gradient at the start, so that neither an offset nor
      a factor matters; from `|f(start)|` if the gradient is negligible;
    - `best`: the best point seen, with its evaluation in user units: feasible with the least objective, else the
      least violated one. None before `begin`;
    - `evaluations`: of the user's model.
    """

    def __init__(self, program: NonlinearProgram, start: np.ndarray):
        self.program = program
        self._free = program.lower < program.upper
        self.useful = np.isfinite(program.constraint_lower) | np.isfinite(program.constraint_upper)
        self._variable_scale = program.variable_scale[self._free]
        self._fixed_variables = np.clip(start, program.lower, program.upper)
        self._last: tuple[bytes, Evaluation] | None = None
        self.evaluations = Evaluations(program)
        self.size, self.rows = int(self._free.sum()), int(self.useful.sum())
        sparsity = program.sparsity
        if sparsity is None:
            sparsity = np.ones((self.useful.size, self._free.size), dtype=bool)
        self._block = Block(sparsity, self.useful, self._free)
        self.sparsity: Matrix = self._block.sparsity
        self.curved: SparseMatrix | None = None
        if program.hessian is not None:
            self._hessian_block = Block(program.hessian.sparsity, self._free, self._free)
            self._hessian_factor = self._hessian_block.factors(1 / self._variable_scale, self._variable_scale)
            self.curved = self._hessian_block.sparsity
        self.lower = program.lower[self._free] / self._variable_scale
        self.upper = program.upper[self._free] / self._variable_scale
        self.best: tuple[np.ndarray, Evaluation] | None = None
        self._objective_origin = 0.0
        self.rescale(
            self._fixed_variables[self._free] / self._variable_scale,
            Scales(1.0, program.constraint_scale[self.useful]),
        )

    def begin(self) -> None:
        """Evaluate the start and set the scale of the objective from it.

        Raises `NotFiniteError` if the model cannot be evaluated at the start, `HaltedError` if it raised an exception.
        """
        first = self.evaluations.finite_at(self.unscaled(self.start))
        steepest = float(np.abs(first.gradient[self._free] * self._variable_scale).max(initial=0.0)) / _FIRST_STEP
        self._objective_origin = first.objective
        size = abs(first.objective)
        objective = steepest if steepest > _ROUNDING * size else size or 1.0
        self.rescale(self.start, self.scales._replace(objective=objective))
        self.evaluate(self.start)

    def rescale(self, z: np.ndarray, scales: Scales) -> None:
        """Continue from `z`, shape (n_free,), in other scales. The caller must convert its multipliers."""
        self.start = np.clip(z, self.lower, self.upper)
        self.scales = scales
        self._jacobian_factor = self._block.factors(scales.constraints, self._variable_scale)
        self.constraint_lower = self.program.constraint_lower[self.useful] / scales.constraints
        self.constraint_upper = self.program.constraint_upper[self.useful] / scales.constraints
        self._last = None

    @property
    def limits(self) -> Sides:
        """The scaled bounds of the useful rows."""
        return Sides(self.constraint_lower, self.constraint_upper)

    def relaxed(self, by: float) -> Sides:
        """The same, equalities relaxed if they outnumber the variables, which some libraries refuse."""
        lower, upper = self.limits
        slack = np.where((lower == upper) & (np.sum(lower == upper) > self.size), by, 0.0)
        return Sides(lower - slack, upper + slack)

    @property
    def sides(self) -> Sides:
        """The scaled bounds of the useful rows, then those of the free variables."""
        return Sides(np.append(self.constraint_lower, self.lower), np.append(self.constraint_upper, self.upper))

    def sizes_at(self, z: np.ndarray, user: Evaluation) -> np.ndarray:
        """Sizes of the useful constraints at `z` with its evaluation in user units, shape (m_useful,)."""
        program = self.program
        sizes = program.constraint_scale if program.sizes is None else program.sizes(self.unscaled(z), user)
        return sizes[self.useful]

    @property
    def no_multipliers(self) -> Multipliers:
        """Zeros."""
        return Multipliers(np.zeros(self.rows), np.zeros(self.size))

    def outside(self, user: Evaluation) -> np.ndarray:
        """How far the useful constraints are outside in user units, negative inside, shape (m_useful,)."""
        return self.program.limits.excess(user.constraints)[self.useful]

    @property
    def every_scale(self) -> np.ndarray:
        """The current scales of all constraints, shape (m,)."""
        scales = self.program.constraint_scale.copy()
        scales[self.useful] = self.scales.constraints
        return scales

    def above_least(self, user: Evaluation) -> float:
        """The objective's distance from its lower bound, over its change over a typical magnitude of the variables.

        Infinite if no lower bound is known.
        """
        change = float(np.abs(user.gradient[self._free] * self._variable_scale).sum())
        return max(user.objective - self.program.least, 0.0) / change if change > 0 else np.inf

    def unscaled(self, z: np.ndarray) -> np.ndarray:
        """All variables in user units, shape (n,), within their bounds."""
        x = self._fixed_variables.copy()
        # Rounding of the quotient must not carry a variable past its bound.
        x[self._free] = z * self._variable_scale
        return np.clip(x, self.program.lower, self.program.upper)

    def user(self, z: np.ndarray) -> Evaluation:
        """The evaluation of `z` in user units, which may be non-finite."""
        return self.evaluations.at(self.unscaled(z))

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Evaluate `z`, scaled.

        Raises `NotFiniteError` if the model cannot be evaluated here, `HaltedError` if the solve must end.
        """
        key = np.asarray(z, dtype=float).tobytes()
        if self._last is None or self._last[0] != key or self.evaluations.halt is not None:
            self._last = None
            user = self.evaluations.finite_at(self.unscaled(z))
            self._last = (key, self.scale(user))
            # In other scales another point may be the least violated.
            if self.best is None or self._rank(user) < self._rank(self.best[1]):
                self.best = (np.array(z, dtype=float), user)
        return self._last[1]

    def scale(self, user: Evaluation) -> Evaluation:
        """Scale an evaluation in user units: free variables and useful rows only."""
        return Evaluation(
            (user.objective - self._objective_origin) / self.scales.objective,
            user.gradient[self._free] * self._variable_scale / self.scales.objective,
            user.constraints[self.useful] / self.scales.constraints,
            self._block.of(user.jacobian, self._jacobian_factor),
        )

    def hessian(self, z: np.ndarray, weight: float, multipliers: np.ndarray) -> np.ndarray:
        """The entries of the scaled Hessian's lower triangle in the order of `curved`, shape (entries,).

        `weight` is that of the scaled objective, `multipliers` those of the useful scaled rows. Raises `NotFiniteError`
        if some entries are not finite, `HaltedError` if the solve must end.
        """
        hessian = self.program.hessian
        if hessian is None:
            return self._differenced(z, weight, multipliers)
        rows = np.zeros(self.useful.size)
        rows[self.useful] = multipliers / self.scales.constraints
        given = self.unscaled(z), weight / self.scales.objective, rows
        whole = checked_sparse("Hessian", self.evaluations.asked(lambda: hessian.evaluate(*given)), hessian.sparsity)
        numbers = entries(self._hessian_block.of(whole, self._hessian_factor))
        if not np.isfinite(numbers).all():
            raise NotFiniteError
        return numbers

    @property
    def can_take_differences(self) -> bool:
        """Whether there is no Hessian, but could be one by differences: of few variables, or if nothing curves."""
        return self.curved is None and (self.size <= MOST_DIFFERENCED or self.evaluations.is_straight)

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
        return True

    def _differenced(self, z: np.ndarray, weight: float, multipliers: np.ndarray) -> np.ndarray:
        assert self.curved is not None
        if self.evaluations.is_straight or self.size > MOST_DIFFERENCED:
            return np.zeros(self.curved.nnz)
        size, rows = np.maximum(1.0, np.abs(z)), self.no_multipliers._replace(rows=multipliers)
        columns = self.curvature(np.array(z, dtype=float), rows, np.diag(size), weight) / size
        return ((columns + columns.T) / 2)[np.tril_indices(self.size)]

    def curvature(
        self, z: np.ndarray, multipliers: Multipliers, directions: np.ndarray, weight: float = 1.0
    ) -> np.ndarray:
        """The derivatives of the Lagrangian's slope along directions of about the size of the variables, shape
        (n_free, k), by central differences, by one-sided ones beside bounds.

        `weight` is that of the objective. Raises `NotFiniteError` where the model has no value on either side.
        """
        size, columns = np.maximum(1.0, np.abs(z)), np.zeros(directions.shape)
        for i, direction in enumerate(directions.T):
            ends = []
            for step in (_STEP, -_STEP, 0.0):
                moved = np.clip(z + step * direction, self.lower, self.upper)
                with contextlib.suppress(NotFiniteError):
                    if step or len(ends) == 1:
                        ends.append((moved, multipliers.slope(self.evaluate(moved), weight)))
            if not ends:
                raise NotFiniteError
            (above, first), (below, second) = ends
            unit = direction / size
            length = float(((above - below) / size) @ unit) / float(unit @ unit)
            columns[:, i] = (first - second) / length if length else 0.0
        return columns

    @property
    def start_objective(self) -> float:
        """The size of the objective at the first start, scaled."""
        return abs(self._objective_origin) / self.scales.objective

    def objective_size(self, evaluation: Evaluation) -> float:
        """The scaled magnitude of the objective, with the offset that a scaled evaluation lacks."""
        return abs(evaluation.objective + self._objective_origin / self.scales.objective)

    def terms(self, evaluation: Evaluation, multipliers: Multipliers) -> float:
        """The scaled magnitude of the terms of the Lagrangian, here and at the start, to which rounding is relative."""
        objective = self.objective_size(evaluation) + self.start_objective
        return objective + float(np.abs(multipliers.rows) @ np.abs(evaluation.constraints))

    def active(self, z: np.ndarray, user: Evaluation, multipliers: Multipliers) -> tuple[np.ndarray, np.ndarray]:
        """The active constraints, shape (m,), and the active bounds of variables, shape (n,), as truth values.

        A value is at its bound, or, from an interior point, nearer to it than the size of its scaled multiplier.
        """
        sides, weights = self.sides, multipliers.every
        values = np.concatenate([user.constraints[self.useful] / self.scales.constraints, z])
        with np.errstate(invalid="ignore"):
            held = (sides.excess(values) >= -_REACHED) | (sides.lower == sides.upper)
            held |= (np.abs(weights) > _REACHED) & (np.abs(weights) > sides.slack(values, weights))
        rows, bounds = np.zeros(self.useful.size, dtype=bool), np.ones(self._free.size, dtype=bool)
        rows[self.useful], bounds[self._free] = held[: self.rows], held[self.rows :]
        return rows, bounds

    def to_user(self, multipliers: Multipliers, user: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers of all rows, shape (m,), and of all bounds, shape (n,), in user units.

        Those of fixed variables make the Lagrangian stationary at an evaluation in user units.
        """
        rows = np.zeros(self.useful.size)
        rows[self.useful] = multipliers.rows * self.scales.objective / self.scales.constraints
        with np.errstate(invalid="ignore", over="ignore"):
            # If the model is not finite, the multipliers are meaningless, and no warning is needed.
            bounds = -(user.gradient + rows @ user.jacobian)
        bounds[self._free] = multipliers.bounds * self.scales.objective / self._variable_scale
        return rows, bounds

    def to_scaled(self, rows: np.ndarray) -> np.ndarray:
        """Scaled multipliers of the useful rows, shape (m_useful,), from those of all rows in user units."""
        return rows[self.useful] * self.scales.constraints / self.scales.objective

    def _rank(self, user: Evaluation) -> tuple[float, float]:
        """Feasible points by their objective, others by their violation."""
        violation = float((self.outside(user) / self.scales.constraints).max(initial=0.0))
        return violation if violation > _NEGLIGIBLE_VIOLATION else 0.0, user.objective
