"""Matrices of a program: dense, or sparse as a `scipy.sparse.csr_array` in canonical form.

SciPy loads a module when it is first used: programs of few variables never need the sparse one.
"""

import copy
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from aleator._core.errors import ProblemError

# SciPy's sparse arrays are hardly typed.
SparseMatrix: TypeAlias = Any
Matrix: TypeAlias = np.ndarray | SparseMatrix

# Steps of a bounded fit of sparse columns, each of as many products at most; and numbers multiplied in all, about a
# second of them.
_LEAST_STEPS, _MOST_STEPS, _MOST_WORK = 5, 100, 4e8
# Rows that depend on one another are told apart by so much of their size.
_DEPENDENT = 1e-10
# Beyond this share of nonzero entries, sparsity saves nothing.
_DENSE = 0.7


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


def spread(sparsity: SparseMatrix, matrix: SparseMatrix) -> SparseMatrix:
    """A matrix whose entries are among those of a sparsity, with zeros for the others of these."""
    ours, theirs = (rows_of_entries(one) * one.shape[1] + one.indices for one in (sparsity, matrix))
    return with_entries(sparsity, np.bincount(np.searchsorted(ours, theirs), matrix.data, sparsity.nnz))


def dense_rows(matrix: Matrix, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Some rows, or all, as a dense array."""
    return matrix[rows] if isinstance(matrix, np.ndarray) else matrix[rows].toarray()


def weighted_rows(weights: np.ndarray, matrix: Matrix) -> Matrix:
    """A matrix, each row times a weight."""
    found = matrix * weights[:, None]
    return found if isinstance(found, np.ndarray) else found.tocsr()


def above_identity(matrix: Matrix) -> Matrix:
    """A matrix of shape (m, n) above the identity: shape (m + n, n), the slopes of rows and variables."""
    if isinstance(matrix, np.ndarray):
        return np.concatenate([matrix, np.eye(matrix.shape[1])])
    return scipy.sparse.vstack([matrix, scipy.sparse.eye_array(matrix.shape[1])], format="csr")


def nonnegative_fit(rows: Matrix, target: np.ndarray) -> np.ndarray:
    """Weights `w >= 0` for which `w @ rows` is closest to a target; zeros, which prove nothing, if not found.

    For sparse rows the search is cut short.
    """
    if isinstance(rows, np.ndarray):
        return _dense_nonnegative_fit(rows.T, target)
    steps = int(np.clip(_MOST_WORK // (_MOST_STEPS * max(rows.nnz, 1)), _LEAST_STEPS, _MOST_STEPS))
    short = {"method": "trf", "max_iter": steps, "lsmr_maxiter": _MOST_STEPS}
    return scipy.optimize.lsq_linear(rows.T.tocsr(), target, (0.0, np.inf), **short).x


def _dense_nonnegative_fit(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """By active sets (Lawson and Hanson, 1974, Solving least squares problems, chapter 23).

    SciPy's takes longer to import than most designs take to find.
    """
    sizes, count = np.linalg.norm(columns, axis=0), columns.shape[1]
    columns = columns / np.where(sizes > 0, sizes, 1.0)
    least = 10 * max(columns.shape) * np.finfo(float).eps * float(np.linalg.norm(target))
    weights, free, barred = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)
    for _ in range(3 * count):
        slope = np.where(free | barred, -np.inf, columns.T @ (target - columns @ weights))
        if not slope.max(initial=-np.inf) > least:
            return weights / np.where(sizes > 0, sizes, 1.0)
        entering = int(np.argmax(slope))
        free[entering] = True
        while True:
            fit = np.zeros(count)
            fit[free] = np.linalg.lstsq(columns[:, free], target, rcond=None)[0]
            negative = free & (fit <= 0)
            if not negative.any():
                weights, barred = fit, np.zeros(count, bool)
                break
            if negative[entering] and weights[entering] == 0:  # by rounding: it would enter again and again
                free[entering], barred[entering] = False, True
                break
            ratios = weights[negative] / (weights[negative] - fit[negative])
            weights = weights + ratios.min() * (fit - weights)
            weights[np.flatnonzero(negative)[ratios == ratios.min()]] = 0.0
            free &= weights > 0
    return np.zeros(count)


def projected(rows: Matrix, units: np.ndarray) -> np.ndarray:
    """Directions, shape (n, k), without what changes some rows, shape (m, n)."""
    if isinstance(rows, np.ndarray):
        return units - np.linalg.lstsq(rows, rows @ units, rcond=None)[0]
    # By the equations `[I, A'; A, -d I] [step; pushes] = [unit; 0]`.
    sizes = abs(rows).max(axis=1).toarray().ravel()
    scaled = weighted_rows(1 / np.where(sizes > 0, sizes, 1.0), rows)
    count, size = scaled.shape
    small = scipy.sparse.diags_array(np.full(count, -_DEPENDENT))
    every = scipy.sparse.block_array([[scipy.sparse.eye_array(size), scaled.T], [scaled, small]], format="csc")
    # Quasi-definite: any order of the diagonal serves as pivots.
    order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    right = np.concatenate([units, np.zeros((count, units.shape[1]))])
    return scipy.sparse.linalg.splu(every, **order).solve(right)[:size]


@final
class Block:
    """Some rows and columns, by truth values, of matrices of one kind, each entry times a factor.

    - `sparsity`: of the block, dense or sparse as the matrices are.
    """

    def __init__(self, sparsity: Matrix, rows: np.ndarray, columns: np.ndarray):
        if isinstance(sparsity, np.ndarray):
            # All rows and columns are no copy.
            self._part: Any = slice(None) if rows.all() and columns.all() else np.ix_(rows, columns)
            self.sparsity: Matrix = sparsity[self._part]
            return
        numbered = with_entries(sparsity, np.arange(1, sparsity.nnz + 1))[rows][:, columns]
        numbered.sort_indices()
        self._part = numbered.data - 1
        self.sparsity = with_entries(numbered, np.ones(numbered.nnz, dtype=bool))

    def factors(self, row_divisors: np.ndarray, column_factors: np.ndarray) -> np.ndarray:
        """The factor of each entry from divisors of rows and factors of columns."""
        if isinstance(self.sparsity, np.ndarray):
            return column_factors / row_divisors[:, None]
        return column_factors[self.sparsity.indices] / row_divisors[rows_of_entries(self.sparsity)]

    def of(self, matrix: Matrix, factors: np.ndarray) -> Matrix:
        """The block of one of these matrices, times the factors of its entries."""
        numbers = entries(matrix)[self._part] * factors
        return numbers if isinstance(self.sparsity, np.ndarray) else with_entries(self.sparsity, numbers)


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
