"""Directions that keep the rows that act, for checking whether a point is a minimum along them."""

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator.nlp._matrices import Matrix, SparseMatrix, rows_of_entries

# Rows that depend on one another are told apart by so much of their size.
_DEPENDENT = 1e-10
# Of more rows than this, elimination takes too long: unit steps serve.
_MOST_ROWS = 100_000
# A direction of which less than this part is left is held by the rows.
_HELD = 1e-6


def tangents(
    jacobian: Matrix, held: np.ndarray, scale: np.ndarray, moved: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k n"]:
    """Steps that move some variables and keep some rows to first order: unit steps, projected on their null space.

    - `jacobian`: of the rows to be kept, shape (rows, n); `held`: variables that may not move, shape (n,);
    - `scale`: typical magnitudes of the variables, shape (n,), in which the projection is orthogonal.

    The largest entry of each step is one typical magnitude; a step that rows do not admit is zero.
    Where there are very many rows, steps are not projected.
    """
    units = (moved[:, None] == np.arange(scale.size)).astype(float)
    if jacobian.shape[0] == 0 or jacobian.shape[0] > _MOST_ROWS:
        return units * scale * ~held
    weights = np.where(held, 0.0, scale)
    project = _by_least_squares if isinstance(jacobian, np.ndarray) else _by_elimination
    projected = project(jacobian * weights, units)
    projected = projected * ~held
    largest = np.abs(projected).max(axis=1, keepdims=True)
    return np.where(largest > _HELD, projected / np.maximum(largest, _HELD), 0.0) * scale


def _by_least_squares(jacobian: np.ndarray, units: np.ndarray) -> np.ndarray:
    return units - np.linalg.lstsq(jacobian, jacobian @ units.T, rcond=None)[0].T


def _by_elimination(jacobian: SparseMatrix, units: np.ndarray) -> np.ndarray:
    """The same for a sparse matrix, by the equations `[I, A'; A, -d I] [step; pushes] = [unit; 0]`."""
    jacobian = jacobian.tocsr()
    sizes = np.zeros(jacobian.shape[0])
    np.maximum.at(sizes, rows_of_entries(jacobian), np.abs(jacobian.data))
    rows = scipy.sparse.diags_array(1 / np.where(sizes > 0, sizes, 1.0)) @ jacobian
    count, size = rows.shape
    small = scipy.sparse.diags_array(np.full(count, -_DEPENDENT))
    every = scipy.sparse.block_array([[scipy.sparse.eye_array(size), rows.T], [rows, small]], format="csc")
    right = np.concatenate([units, np.zeros((len(units), count))], axis=1)
    # Quasi-definite: any order of the diagonal serves as pivots.
    order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return scipy.sparse.linalg.splu(every, **order).solve(np.ascontiguousarray(right.T))[:size].T
