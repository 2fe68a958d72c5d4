"""The nonlinear program: objective, constraints, bounds, derivatives and typical magnitudes; its matrices.

A sparse matrix is a `scipy.sparse.csr_array` in canonical form. SciPy loads a module when it is first used: programs of
few variables never need the sparse one.
"""

import contextlib
import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
import scipy

from aleator._core.errors import ProblemError

# SciPy's sparse arrays are hardly typed.
SparseMatrix: TypeAlias = Any
Matrix: TypeAlias = np.ndarray | SparseMatrix


class Evaluation(NamedTuple):
    """Objective, constraints and their first derivatives at one point, from one call of the model.

    - `objective`: `f(x)`, a number;
    - `gradient`: `∂f/∂x`, shape (n,);
    - `constraints`: `c(x)`, shape (m,);
    - `jacobian`: `∂c/∂x`, shape (m, n): dense, or a `scipy.sparse.csr_array` if the program declares its sparsity.
    """

    objective: float
    gradient: np.ndarray
    constraints: np.ndarray
    jacobian: Matrix

    @property
    def is_finite(self) -> bool:
        """Whether every number is finite, as solvers need."""
        numbers = self.gradient, self.constraints, entries(self.jacobian)
        return bool(np.isfinite(self.objective) and all(np.isfinite(part).all() for part in numbers))


class Hessian(NamedTuple):
    """The lower triangle of the second derivatives of the Lagrangian `w f(x) + λᵀ c(x)`.

    - `evaluate`: returns it as a `scipy.sparse.csr_array` at `x` of shape (n,), for a weight `w` of the objective and
      multipliers `λ` of shape (m,), in the user's units;
    - `sparsity`: a `csr_array` of shape (n, n) of the entries that may be nonzero, the same for all results.
    """

    evaluate: Callable[[np.ndarray, float, np.ndarray], SparseMatrix]
    sparsity: SparseMatrix


class Sides(NamedTuple):
    """Lower and upper bounds of some values, shape (k,) each, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray

    def excess(self, values: np.ndarray) -> np.ndarray:
        """How far values of shape (..., k) are outside, negative inside."""
        return np.maximum(values - self.upper, self.lower - values)

    def slack(self, values: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """How far each value is from the bound against which its multiplier presses, the upper one if positive."""
        return np.abs(np.where(multipliers > 0, self.upper - values, values - self.lower))

    def within(self, values: np.ndarray, distance: float = np.inf) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The bounds no further than this from their values: places of these, signs, +1 for an upper bound, and gaps.

        A gap is negative where the value is outside.
        """
        gaps = np.concatenate([self.upper - values, values - self.lower])
        near = np.flatnonzero(np.isfinite(gaps) & (np.abs(gaps) <= distance))
        return near % values.size, np.where(near < values.size, 1.0, -1.0), gaps[near]


@final
@dataclass(frozen=True)
class NonlinearProgram:
    """Minimise `f(x)` subject to `constraint_lower <= c(x) <= constraint_upper` and `lower <= x <= upper`.

    Everything is in the user's units; the solvers scale inside.

    - `evaluate`: returns the `Evaluation` at `x` of shape (n,). Non-finite numbers in it mean "cannot be evaluated
      here", and solvers step back; an exception ends the solve and reaches its caller;
    - `start`: initial variables, shape (n,);
    - `lower`, `upper`: bounds of the variables, shape (n,), infinite if there is none, equal to fix a variable;
    - `constraint_lower`, `constraint_upper`: bounds of the constraints, shape (m,), infinite if there is none,
      equal for an equality;
    - `constraint_scale`: typical magnitudes by which solvers divide the constraints at first, shape (m,), positive;
    - `variable_scale`: typical magnitudes of the variables, shape (n,), positive;
    - `sparsity`: the entries of the Jacobian that may be nonzero, shape (m, n); all by default. A dense array of truth
      values is a guess: solvers that use it detect entries outside it. A `scipy.sparse.csr_array` is the sparsity of
      every Jacobian, which then is sparse too: no dense array of size m x n is ever made;
    - `hessian`: second derivatives, if known; all solvers but `Slsqp` use them;
    - `sizes`: the magnitudes of the constraints, shape (m,), at a point `x` with its evaluation, in the user's units:
      violations are relative to them, and solvers continue from there in them. By default `constraint_scale`;
    - `values`: the objective, shape (k,), and the constraints, shape (k, m), at points of shape (k, n), without
      derivatives; NaN where the model cannot be evaluated. For searches, which call `evaluate` where it is None;
    - `least`: a lower bound of the objective, such as 0 for a norm: a point that attains it is optimal, even at a kink.
      Minus infinity if none is known;
    - `breadth`: how many variables are tied from one point of time to the next, where the program is such a chain: the
      order in which sparse matrices are best factorised depends on it.

    Raises `ProblemError` if shapes differ, bounds cross, scales are not positive or the start is not finite.
    """

    evaluate: Callable[[np.ndarray], Evaluation]
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    constraint_lower: np.ndarray
    constraint_upper: np.ndarray
    constraint_scale: np.ndarray
    variable_scale: np.ndarray
    sparsity: Matrix | None = None
    hessian: Hessian | None = None
    sizes: Callable[[np.ndarray, Evaluation], np.ndarray] | None = None
    least: float = -np.inf
    values: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None
    breadth: int = 1

    def __post_init__(self) -> None:
        shape = rows, size = np.size(self.constraint_lower), np.size(self.start)
        lengths = dict.fromkeys(("start", "lower", "upper", "variable_scale"), size)
        lengths |= dict.fromkeys(("constraint_lower", "constraint_upper", "constraint_scale"), rows)
        for name, length in lengths.items():
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (length,):
                raise ProblemError(f"Expected `{name}` of shape ({length},). Received shape {array.shape}.")
            object.__setattr__(self, name, array)
        if isinstance(self.sparsity, np.ndarray) and self.sparsity.shape != shape:
            raise ProblemError(f"Expected `sparsity` of shape {shape}. Received shape {self.sparsity.shape}.")
        if not isinstance(self.sparsity, np.ndarray | None):
            check_sparsity("sparsity", self.sparsity, shape)
        if self.hessian is not None:
            check_sparsity("hessian", curved := self.hessian.sparsity, (size, size))
            if np.any(curved.indices > rows_of_entries(curved)):
                raise ProblemError(
                    "Expected the lower triangle of `hessian` alone; received entries above its diagonal."
                )
        checks = [
            (f"`{name}lower` <= `{name}upper`", (low, high), (low <= high) & (low < np.inf) & (high > -np.inf))
            for name, low, high in (("", self.lower, self.upper), ("constraint_", *self.limits))
        ]
        checks += [
            (f"`{name}` positive and finite", (scale,), np.isfinite(scale) & (scale > 0))
            for name, scale in (("variable_scale", self.variable_scale), ("constraint_scale", self.constraint_scale))
        ]
        for expected, values, holds in (*checks, ("a finite `start`", (self.start,), np.isfinite(self.start))):
            if not holds.all():
                first = int(np.argmin(holds))
                received = " and ".join(str(one[first]) for one in values)
                raise ProblemError(f"Expected {expected}. Received {received} at index {first}.")

    def is_least(self, objective: float, tolerance: float) -> bool:
        """Whether an objective is at its lower bound, as far as can be told beside its fall from the start."""
        if not np.isfinite(self.least):
            return False
        return objective - self.least <= tolerance * (self.evaluate(self.start).objective - self.least)

    @property
    def limits(self) -> Sides:
        """The bounds of the constraints."""
        return Sides(self.constraint_lower, self.constraint_upper)


# --- Matrices, dense or sparse --------------------------------------------------------------------------------------

# Steps of a bounded fit of sparse columns, each of as many products at most; and numbers multiplied in all, about a
# second of them.
_LEAST_STEPS, _MOST_STEPS, _MOST_WORK = 5, 100, 4e8
# As many dense rows are fitted before SciPy's function, which takes half a second to load, would have been.
_FEW_ROWS = 100
# Of sums of products, as a part of the sum of their magnitudes.
_ROUNDING = 4 * np.finfo(float).eps


def entries(matrix: Matrix) -> np.ndarray:
    """The numbers of a matrix; of a sparse one its stored entries."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.data


def rows_of_entries(matrix: SparseMatrix) -> np.ndarray:
    """The row of each entry, shape (entries,)."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def with_entries(sparsity: SparseMatrix, numbers: np.ndarray) -> SparseMatrix:
    """The matrix with these entries, in the order of a sparsity."""
    # The constructor would check the sparsity each time.
    found = copy.copy(sparsity)
    found.data = numbers
    return found


def largest_term(weights: np.ndarray, matrix: Matrix) -> float:
    """The largest `|w_i A_ij|`; zero if there is none."""
    if isinstance(matrix, np.ndarray):
        used = np.flatnonzero(weights)
        return float(np.abs(weights[used, None] * matrix[used]).max(initial=0.0))
    return float(np.abs(weights[rows_of_entries(matrix)] * matrix.data).max(initial=0.0))


def zero_columns(matrix: Matrix) -> np.ndarray:
    """Which columns are zero, shape (n,)."""
    if isinstance(matrix, np.ndarray):
        return np.logical_not(matrix.any(axis=0))
    return ~np.isin(np.arange(matrix.shape[1]), matrix.indices[matrix.data != 0])


def dense_rows(matrix: Matrix, rows: np.ndarray) -> np.ndarray:
    """Some rows as a dense array."""
    return matrix[rows] if isinstance(matrix, np.ndarray) else matrix[rows].toarray()


def above_identity(matrix: Matrix) -> Matrix:
    """A matrix of shape (m, n) above the identity: shape (m + n, n), the slopes of rows and variables."""
    if isinstance(matrix, np.ndarray):
        return np.concatenate([matrix, np.eye(matrix.shape[1])])
    return scipy.sparse.vstack([matrix, scipy.sparse.eye_array(matrix.shape[1])], format="csr")


def nonnegative_fit(rows: Matrix, target: np.ndarray) -> np.ndarray:
    """Weights `w >= 0` for which `w @ rows` is closest to a target; zeros, which prove nothing, if not found.

    For sparse rows the search is cut short.
    """
    if isinstance(rows, np.ndarray) and len(rows) <= _FEW_ROWS:
        return _fit_of_few(rows, target)
    if isinstance(rows, np.ndarray):
        try:
            return scipy.optimize.nnls(rows.T, target)[0]
        except RuntimeError:
            # SciPy raises this when its iterations are used up.
            return np.zeros(len(rows))
    steps = int(np.clip(_MOST_WORK // (_MOST_STEPS * max(rows.nnz, 1)), _LEAST_STEPS, _MOST_STEPS))
    short = {"method": "trf", "max_iter": steps, "lsmr_maxiter": _MOST_STEPS}
    return scipy.optimize.lsq_linear(rows.T.tocsr(), target, (0.0, np.inf), **short).x


def _fit_of_few(rows: np.ndarray, target: np.ndarray) -> np.ndarray:
    """See `nonnegative_fit`: by Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23.

    One row after the other is taken, that along which the remainder falls most. It is refused if the remainder does not
    become smaller, so that the search ends.
    """
    sizes, weights = np.abs(rows), np.zeros(len(rows))
    taken = refused = np.zeros(len(rows), dtype=bool)
    while True:
        left, rounding = target - weights @ rows, _ROUNDING * sizes @ (np.abs(target) + weights @ sizes)
        descent = np.where(taken | refused, 0.0, rows @ left - rounding)
        if descent.max(initial=0.0) <= 0.0:
            return weights
        further = np.arange(len(rows)) == descent.argmax()
        among, trial = taken | further, weights
        while True:
            fit = _least_squares(rows, among, target)
            if not (falling := among & (fit < 0.0)).any():
                break
            # So far no weight becomes negative. Rows whose weight becomes zero are dropped.
            ways = np.divide(trial, trial - fit, out=np.full(len(rows), np.inf), where=falling)
            trial = np.maximum(trial + ways.min() * (fit - trial), 0.0)
            among = among & (ways > ways.min())
        if np.linalg.norm(target - fit @ rows) < np.linalg.norm(left):
            weights, taken, refused = fit, among, np.zeros(len(rows), dtype=bool)
        else:
            refused = refused | further


def _least_squares(rows: np.ndarray, among: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Weights of some rows, zero for others, whose sum is closest to a target: by the normal equations, corrected once;
    zeros if rows depend on one another.
    """
    weights, some = np.zeros(len(rows)), rows[among]
    with contextlib.suppress(np.linalg.LinAlgError):
        inverse = np.linalg.inv(some @ some.T)
        for _ in range(2):
            weights[among] += inverse @ (some @ (target - weights @ rows))
    return weights


@final
class Block:
    """Some rows and columns of matrices that share a sparsity, times a factor for each entry.

    - `sparsity`: of the block.
    """

    def __init__(self, sparsity: SparseMatrix, rows: np.ndarray, columns: np.ndarray):
        numbered = with_entries(sparsity, np.arange(1, sparsity.nnz + 1))[rows][:, columns]
        numbered.sort_indices()
        self._places = numbered.data - 1
        self.sparsity = with_entries(numbered, np.ones(numbered.nnz, dtype=bool))
        self._rows = rows_of_entries(numbered)

    def factors(self, row_factors: np.ndarray, column_factors: np.ndarray) -> np.ndarray:
        """The factor of each entry, shape (entries,), from those of rows and columns."""
        return row_factors[self._rows] * column_factors[self.sparsity.indices]

    def of(self, matrix: SparseMatrix, factors: np.ndarray) -> SparseMatrix:
        """The block of one of these matrices, times the factors of its entries."""
        return with_entries(self.sparsity, matrix.data[self._places] * factors)


def check_sparsity(name: str, sparsity: SparseMatrix, shape: tuple[int, int]) -> None:
    """Refuse anything but a sparsity of this shape: a `csr_array` with sorted columns and no duplicates."""
    is_sparse = isinstance(sparsity, scipy.sparse.csr_array) and sparsity.shape == shape
    if not is_sparse or not sparsity.has_canonical_format:
        raise ProblemError(
            f"Expected `{name}` as a scipy.sparse.csr_array of shape {shape}, its columns in order and no entry twice "
            f"(call sum_duplicates()). Received {type(sparsity).__name__} of shape {getattr(sparsity, 'shape', None)}."
        )


def checked_sparse(name: str, matrix: Any, sparsity: SparseMatrix) -> SparseMatrix:
    """A matrix with the declared sparsity, its numbers copied. Raises `ProblemError` for another."""
    if not (
        isinstance(matrix, scipy.sparse.csr_array)
        and matrix.shape == sparsity.shape
        and np.array_equal(matrix.indptr, sparsity.indptr)
        and np.array_equal(matrix.indices, sparsity.indices)
    ):
        raise ProblemError(
            f"Expected the {name} as a scipy.sparse.csr_array with the sparsity declared, {sparsity.nnz} entries in "
            f"shape {sparsity.shape}; received {getattr(matrix, 'nnz', type(matrix).__name__)} in shape "
            f"{np.shape(matrix)}, or others. Keep zeros in place."
        )
    return with_entries(sparsity, np.array(matrix.data, dtype=float))


# Beyond this share of nonzero entries, sparsity saves nothing.
_DENSE = 0.7


@final
class Pattern:
    """The entries of a Jacobian that a solver works with: declared if the sparsity is sparse, a guess if it is dense.

    - `rows`, `columns`: of the entries, column by column, shape (entries,);
    - `outgrown`: whether a nonzero entry has turned up outside a guess.
    """

    def __init__(self, sparsity: Matrix):
        self.outgrown = False
        if isinstance(sparsity, np.ndarray):
            is_dense = sparsity.size == 0 or bool(np.mean(sparsity != 0) > _DENSE)
            self.columns, self.rows = np.nonzero(np.ones_like(sparsity.T) if is_dense else sparsity.T)
        else:
            self._order = np.argsort(sparsity.indices, kind="stable")
            self.rows, self.columns = rows_of_entries(sparsity)[self._order], sparsity.indices[self._order]

    def entries(self, jacobian: Matrix) -> np.ndarray:
        """The entries of a Jacobian of shape (m, n), shape (entries,)."""
        if not isinstance(jacobian, np.ndarray):
            return jacobian.data[self._order]
        inside = jacobian[self.rows, self.columns]
        self.outgrown = self.outgrown or bool(np.count_nonzero(jacobian) > np.count_nonzero(inside))
        return inside


# Rows that depend on one another are told apart by so much of their size.
_DEPENDENT = 1e-10


def projected(rows: Matrix, units: np.ndarray) -> np.ndarray:
    """Directions, shape (n, k), without what changes some rows, shape (m, n)."""
    if isinstance(rows, np.ndarray):
        return units - np.linalg.lstsq(rows, rows @ units, rcond=None)[0]
    # By the equations `[I, A'; A, -d I] [step; pushes] = [unit; 0]`.
    sizes = abs(rows).max(axis=1).toarray().ravel()
    scaled = scipy.sparse.diags_array(1 / np.where(sizes > 0, sizes, 1.0)) @ rows
    count, size = scaled.shape
    small = scipy.sparse.diags_array(np.full(count, -_DEPENDENT))
    every = scipy.sparse.block_array([[scipy.sparse.eye_array(size), scaled.T], [scaled, small]], format="csc")
    # Quasi-definite: any order of the diagonal serves as pivots.
    order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    right = np.concatenate([units, np.zeros((count, units.shape[1]))])
    return scipy.sparse.linalg.splu(every, **order).solve(right)[:size]
