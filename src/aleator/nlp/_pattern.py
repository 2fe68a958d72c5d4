"""Sparsity patterns of Jacobians: solvers work less on rows that depend on few variables."""

from typing import TypeAlias, final

import numpy as np

from aleator.nlp._matrices import Matrix, SparseMatrix, rows_of_entries

# Beyond this share of nonzero entries, sparsity saves nothing.
_DENSE = 0.7
# After this many extensions the Jacobian counts as dense.
_MOST_WIDENINGS = 2


@final
class Pattern:
    """The entries of a Jacobian that a solver works with.

    If a nonzero entry turns up outside the pattern, it is `outgrown`, and the solver continues with `widened()`.

    - `rows`, `columns`: of the entries, column by column, shape (entries,).
    """

    def __init__(self, nonzero: np.ndarray, widenings: int = 0):
        self._widenings = widenings
        dense = nonzero.size == 0 or widenings == _MOST_WIDENINGS or bool(nonzero.mean() > _DENSE)
        self._nonzero = np.ones_like(nonzero) if dense else nonzero
        self.columns, self.rows = np.nonzero(self._nonzero.T)
        self._places = self.rows * nonzero.shape[1] + self.columns
        self.outgrown = False

    def entries(self, jacobian: np.ndarray) -> np.ndarray:
        """The entries of a Jacobian of shape (m, n), shape (entries,)."""
        found = jacobian.ravel()[self._places]
        if np.count_nonzero(jacobian) > np.count_nonzero(found):
            self._nonzero = self._nonzero | (jacobian != 0)
            self.outgrown = True
        return found

    def widened(self) -> "Pattern":
        """The pattern extended by the new entries; with all entries after too many extensions."""
        return Pattern(self._nonzero, self._widenings + 1)


@final
class DeclaredPattern:
    """The declared sparsity of a program's Jacobians, which is never outgrown; see `Pattern`."""

    outgrown = False

    def __init__(self, sparsity: SparseMatrix):
        self.rows, self.columns = rows_of_entries(sparsity), sparsity.indices

    def entries(self, jacobian: SparseMatrix) -> np.ndarray:
        """The entries of a Jacobian, shape (entries,)."""
        return jacobian.data

    def widened(self) -> "DeclaredPattern":
        """The same pattern, because it is complete."""
        return self


AnyPattern: TypeAlias = Pattern | DeclaredPattern


def pattern_of(sparsity: Matrix) -> AnyPattern:
    """The pattern for a program's sparsity: a guess if dense, declared if sparse."""
    return Pattern(sparsity) if isinstance(sparsity, np.ndarray) else DeclaredPattern(sparsity)
