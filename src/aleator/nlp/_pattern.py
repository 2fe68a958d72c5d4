"""Where a Jacobian may be other than zero: solvers work less on rows that depend on few variables."""

from typing import TypeAlias, final

import numpy as np

from aleator.nlp._matrices import Matrix, SparseMatrix, rows_of_entries

# Beyond this share of entries other than zero, keeping them apart saves nothing.
_DENSE = 0.7
# After this many extensions the Jacobian counts as dense.
_MOST_WIDENINGS = 2


@final
class Pattern:
    """The entries of a Jacobian that a solver is told of.

    An entry that shows up beside them outgrows the pattern: it is then `outgrown`, and the solver is to go on with
    `widened()`.

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
        """The pattern with the entries that outgrew it; of all entries when that happens again and again."""
        return Pattern(self._nonzero, self._widenings + 1)


@final
class DeclaredPattern:
    """The sparsity that every Jacobian of a program has. It is never outgrown; see `Pattern`."""

    outgrown = False

    def __init__(self, sparsity: SparseMatrix):
        self.rows, self.columns = rows_of_entries(sparsity), sparsity.indices

    def entries(self, jacobian: SparseMatrix) -> np.ndarray:
        """The entries of a Jacobian, shape (entries,)."""
        return jacobian.data

    def widened(self) -> "DeclaredPattern":
        """The same: there is nothing beside it."""
        return self


AnyPattern: TypeAlias = Pattern | DeclaredPattern


def pattern_of(sparsity: Matrix) -> AnyPattern:
    """What a solver is told of where a program's Jacobian may be other than zero."""
    return Pattern(sparsity) if isinstance(sparsity, np.ndarray) else DeclaredPattern(sparsity)
