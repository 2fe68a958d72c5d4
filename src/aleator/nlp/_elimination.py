"""Eliminates the variables that ties determine, and condenses the system of an interior-point step to the others.

The square matrix of ties by their variables is permuted to block triangular form (Duff and Reid 1978: strongly
connected components, in topological order). For realisations that are collocated over time a block is one interval of
one realisation. Blocks that depend only on earlier ones form a level; those of one level and size are solved in one
call, so that the number of calls does not depend on the number of realisations.

The tied variables follow from the others by the linearised ties, whatever the curvature is. What is left is dense and
small, and its eigenvalues say exactly whether the step is one towards a minimum: the inertia of the whole matrix is
that of the rest plus as many positive as negative eigenvalues as there are ties (Nocedal and Wright 2006, section
16.3). Unlike a factorisation of the whole, this loses digits where ties amplify errors, as unstable realisations do.
"""

from copy import copy
from typing import NamedTuple, final

import numpy as np
import scipy

from aleator.nlp._matrices import SparseMatrix, rows_of_entries, with_entries
from aleator.nlp._program import Ties

# Beyond this condition number, in the largest row sum, a block determines its variables too badly.
_WORST_CONDITION = 1e13


@final
class SingularTiesError(ArithmeticError):
    """Some ties do not determine their variables; the message says which."""


class _Group(NamedTuple):
    """Blocks of one level and size.

    - `where`: their variables among all in order; `size`: of each block; `blocks`: their places among those of a size.
    """

    where: slice
    size: int
    blocks: slice


@final
class Elimination:
    """The levels of a pattern, found once.

    - `rows`, `variables`: those that are tied, in the order of the levels, shape (ties,);
    - `own`, `decided`: the other rows and variables, in their order.

    Raises `SingularTiesError` if no numbers in this pattern would determine the variables.
    """

    def __init__(self, ties: Ties, sparsity: SparseMatrix):
        numbered = with_entries(sparsity, np.arange(1, sparsity.nnz + 1))
        square = numbered[ties.rows][:, ties.variables].tocsr()
        matched = _matched(square, ties)
        square = square[matched]
        levels, labels = _levels(square)
        sizes = np.bincount(labels)
        order = np.lexsort((labels, sizes[labels], levels[labels]))
        self.rows, self.variables = ties.rows[matched][order], ties.variables[order]
        self.own, self.decided = (
            _others(some, count) for some, count in zip((self.rows, self.variables), sparsity.shape, strict=True)
        )
        decided = numbered[self.rows][:, self.decided]
        self._by_decided = _Slice(decided.data - 1, decided)
        self._owners = ties.owners[order]
        square = square[order][:, order].tocsr()
        square.sort_indices()
        self._groups = _groups(levels[labels[order]], sizes[labels[order]])
        self._split(square, labels[order])

    def _split(self, square: SparseMatrix, labels: np.ndarray) -> None:
        """The places of the entries in blocks, and those outside them row by row and column by column."""
        rows, columns, places = rows_of_entries(square), square.indices, square.data - 1
        inside = labels[rows] == labels[columns]
        first = np.flatnonzero(np.diff(labels, prepend=-1))
        starts = np.repeat(first, np.diff(np.append(first, labels.size)))
        sizes = np.repeat(np.diff(np.append(first, labels.size)), np.diff(np.append(first, labels.size)))
        self._inside: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        for size in sorted({one.size for one in self._groups}):
            # The blocks of one size, one after the other in order.
            number = np.cumsum((sizes == size) & (starts == np.arange(labels.size))) - 1
            these = inside & (sizes[rows] == size)
            row, column = rows[these], columns[these]
            flat = (number[row] * size + row - starts[row]) * size + column - starts[column]
            self._inside[size] = places[these], flat, first[sizes[first] == size]
        outside = scipy.sparse.csr_array((places[~inside] + 1, (rows[~inside], columns[~inside])), shape=square.shape)
        turned = outside.T.tocsr()
        self._outside = [_sliced(one, self._groups) for one in (outside, turned)]

    def by_decided(self, entries: np.ndarray) -> np.ndarray:
        """The derivatives of the ties by the other variables, for the entries of a Jacobian."""
        return self._by_decided.of(entries).toarray()

    def factorised(self, entries: np.ndarray) -> "Factors":
        """For the entries of a Jacobian. Raises `SingularTiesError` if a block is singular or nearly so."""
        inverses = {}
        for size, (places, flat, first) in self._inside.items():
            blocks = np.zeros((first.size, size, size))
            blocks.ravel()[flat] = entries[places]
            inverses[size] = self._inverses(blocks, first)
        return Factors(self._groups, inverses, [[part.of(entries) for part in parts] for parts in self._outside])

    def _inverses(self, blocks: np.ndarray, first: np.ndarray) -> np.ndarray:
        try:
            # For single numbers a call each costs more than the arithmetic.
            inverses = 1 / np.where(blocks, blocks, np.nan) if blocks.shape[1] == 1 else np.linalg.inv(blocks)
        except np.linalg.LinAlgError:
            inverses = np.full(blocks.shape, np.nan)
            regular = np.linalg.matrix_rank(blocks) == blocks.shape[1]
            inverses[regular] = np.linalg.inv(blocks[regular])
        condition = np.abs(blocks).sum(axis=2).max(axis=1) * np.abs(inverses).sum(axis=2).max(axis=1)
        determined = condition < _WORST_CONDITION
        if not determined.all():
            worst = int(first[np.argmin(determined)])
            raise SingularTiesError(_named(self._owners[worst], self.variables[worst], self.rows[worst]))
        return inverses


@final
class Factors:
    """Solves systems with the square matrix of ties, and with its transpose, in the order of the levels."""

    def __init__(self, groups: list[_Group], inverses: dict[int, np.ndarray], outside: list[list[SparseMatrix]]):
        self._groups, self._inverses, (self._before, self._after) = groups, inverses, outside

    def solve(self, right: np.ndarray) -> np.ndarray:
        """`A⁻¹ right`, shape (ties, columns)."""
        found = np.zeros(right.shape)
        for group, before in zip(self._groups, self._before, strict=True):
            left = right[group.where] - before @ found
            inverses = self._inverses[group.size][group.blocks]
            found[group.where] = _applied(inverses, left)
        return found

    def solve_transposed(self, right: np.ndarray) -> np.ndarray:
        """`A⁻ᵀ right`, shape (ties, columns)."""
        found = np.zeros(right.shape)
        for group, after in zip(reversed(self._groups), reversed(self._after), strict=True):
            left = right[group.where] - after @ found
            inverses = self._inverses[group.size][group.blocks]
            found[group.where] = _applied(inverses.transpose(0, 2, 1), left)
        return found


class _Slice(NamedTuple):
    """Some rows of a matrix: the places of their entries in the Jacobian, and the matrix to be filled."""

    places: np.ndarray
    matrix: SparseMatrix

    def of(self, entries: np.ndarray) -> SparseMatrix:
        # A constructor would check what is known.
        filled = copy(self.matrix)
        filled.data = entries[self.places]
        return filled


def _sliced(numbered: SparseMatrix, groups: list[_Group]) -> list[_Slice]:
    each = [numbered[group.where] for group in groups]
    return [_Slice(one.data - 1, one) for one in each]


def _applied(inverses: np.ndarray, right: np.ndarray) -> np.ndarray:
    blocks, size, _ = inverses.shape
    return np.matmul(inverses, right.reshape(blocks, size, -1)).reshape(right.shape)


def _others(some: np.ndarray, count: int) -> np.ndarray:
    """The numbers below a count that are not among some."""
    left = np.ones(count, dtype=bool)
    left[some] = False
    return np.flatnonzero(left)


def _matched(square: SparseMatrix, ties: Ties) -> np.ndarray:
    """The row of each variable, such that no diagonal entry is missing."""
    if np.all(square.diagonal() != 0):
        return np.arange(square.shape[0])
    matched = scipy.sparse.csgraph.maximum_bipartite_matching(square, perm_type="row")
    if np.any(matched < 0):
        lost = int(np.argmin(matched))
        raise SingularTiesError(_named(ties.owners[lost], ties.variables[lost], None))
    return matched


def _levels(square: SparseMatrix) -> tuple[np.ndarray, np.ndarray]:
    """The level of each strongly connected component, and the component of each row."""
    count, labels = scipy.sparse.csgraph.connected_components(square, directed=True, connection="strong")
    rows, columns = labels[rows_of_entries(square)], labels[square.indices]
    other = rows != columns
    # Each edge once: SciPy sums duplicates.
    follows = scipy.sparse.csr_array((np.ones(other.sum()), (columns[other], rows[other])), shape=(count, count))
    waiting, levels, level = np.bincount(follows.indices, minlength=count), np.zeros(count, dtype=int), 0
    ready = np.flatnonzero(waiting == 0)
    while ready.size:
        levels[ready] = level
        next_ = follows[ready].indices
        np.subtract.at(waiting, next_, 1)
        ready, level = np.unique(next_[waiting[next_] == 0]), level + 1
    return levels, labels


def _groups(levels: np.ndarray, sizes: np.ndarray) -> list[_Group]:
    """Groups of variables in order, from the level and the block's size of each."""
    begins = np.flatnonzero((np.diff(levels, prepend=-1) != 0) | (np.diff(sizes, prepend=-1) != 0))
    found, used = [], dict.fromkeys(sizes.tolist(), 0)
    for begin, end in zip(begins, np.append(begins[1:], levels.size), strict=True):
        size = int(sizes[begin])
        blocks = slice(used[size], used[size] + (end - begin) // size)
        used[size] = blocks.stop
        found.append(_Group(slice(int(begin), int(end)), size, blocks))
    return found


def _named(owner: int, variable: int, row: int | None) -> str:
    whose = f" of realisation {owner}" if owner >= 0 else ""
    by = "the rows tied to it" if row is None else f"row {row} and those tied with it"
    return f"variable {variable}{whose} is not determined by {by}"


# Rounds of refinement, and the residual, relative to the right side, at which no more are needed.
_MOST_REFINEMENTS, _REFINED = 5, 1e-12
# A residual beyond this, relative to the right side, is that of another system.
_LOST = 1e-4
# Eigenvalues of the equilibrated matrix below this count as zero.
_ZERO = 1e-14
# Rounds of equilibration.
_EQUILIBRATIONS = 3


@final
class IllConditionedError(ArithmeticError):
    """The system cannot be solved to a few digits."""


class Matrices(NamedTuple):
    """The numbers of a system.

    - `hessian`: the lower triangle, shape (n, n); `diagonal`: added to it, shape (n,);
    - `jacobian`: shape (m, n); `softness`: subtracted on the rows' diagonal, shape (m,); zero for equalities.
    """

    hessian: SparseMatrix
    diagonal: np.ndarray
    jacobian: SparseMatrix
    softness: np.ndarray


@final
class Condensed:
    """A system, condensed: `[[H + D, Jᵀ], [J, -S]]` with the Hessian, diagonal, Jacobian and softness of `Matrices`.

    - `decided`: the variables that no tie determines; `own`: the rows that are no ties.
    """

    def __init__(self, elimination: Elimination, matrices: Matrices):
        jacobian = matrices.jacobian
        tied_rows, tied = elimination.rows, elimination.variables
        self._factors: Factors = elimination.factorised(jacobian.data)
        self._matrices, self._tied_rows, self._tied = matrices, tied_rows, tied
        self.decided, self.own = elimination.decided, elimination.own
        follows = -self._factors.solve(elimination.by_decided(jacobian.data))
        moves = np.zeros((jacobian.shape[1], self.decided.size))
        moves[tied], moves[self.decided] = follows, np.eye(self.decided.size)
        self._moves = moves
        half = moves.T @ (matrices.hessian @ moves)
        # The lower triangle, added to its transpose, has its diagonal twice.
        self._diagonal = matrices.diagonal - matrices.hessian.diagonal()
        self._curvature = half + half.T + moves.T @ (self._diagonal[:, None] * moves)
        self._own_jacobian = jacobian[self.own]
        slopes = self._own_jacobian @ moves
        softness = matrices.softness[self.own]
        self._slopes, self._soft = slopes, softness > 0
        self._curvature += (slopes[self._soft].T / softness[self._soft]) @ slopes[self._soft]
        self._softness = softness
        self._shift = self._row_shift = 0.0
        self._inverse = np.zeros((0, 0))

    def regularise(self, curvature: float, rows: float) -> tuple[int, int]:
        """Add to the curvature of the decided variables, subtract from the diagonal of equalities.

        Returns how many positive and how many negative eigenvalues a minimum would have more. Raises
        `IllConditionedError` if some numbers are not finite.
        """
        self._shift, self._row_shift = curvature, rows
        hard = self._slopes[~self._soft]
        size, count = self._curvature.shape[0], hard.shape[0]
        whole = np.zeros((size + count, size + count))
        whole[:size, :size] = self._curvature + curvature * np.eye(size)
        whole[size:, :size], whole[:size, size:] = hard, hard.T
        whole[size:, size:] -= rows * np.eye(count)
        if not np.isfinite(whole).all():
            raise IllConditionedError
        scale = np.ones(size + count)
        for _ in range(_EQUILIBRATIONS):
            largest = np.abs(whole * scale[:, None] * scale).max(axis=1, initial=0.0)
            scale /= np.sqrt(np.where(largest > 0, largest, 1.0))
        values, vectors = np.linalg.eigh(whole * scale[:, None] * scale)
        zero = np.abs(values) <= _ZERO
        with np.errstate(divide="ignore"):
            self._inverse = (vectors / np.where(zero, np.inf, values)) @ vectors.T * scale[:, None] * scale
        return size - int(np.sum(values > _ZERO)), count - int(np.sum(values < -_ZERO))

    def solve(self, by_variables: np.ndarray, by_rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The step and the multipliers for a right side, refined.

        Raises `IllConditionedError` if the residual does not become small.
        """
        step, rows = np.zeros(by_variables.size), np.zeros(by_rows.size)
        left = by_variables, by_rows
        right = smallest = _size(left)
        for _ in range(1 + _MOST_REFINEMENTS):
            more = self._solved(*left)
            there = step + more[0], rows + more[1]
            found, held = self._product(*there)
            rest = by_variables - found, by_rows - held
            size = _size(rest)
            if not size < smallest:
                break
            (step, rows), left, smallest = there, rest, size
            if smallest <= _REFINED * right:
                break
        if smallest > _LOST * right:
            raise IllConditionedError
        return step, rows

    def _curved(self, step: np.ndarray) -> np.ndarray:
        """The Hessian and its diagonal times a step."""
        lower = self._matrices.hessian
        return lower @ step + lower.T @ step + self._diagonal * step

    def _product(self, step: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The whole matrix times a vector, by variables and by rows."""
        matrices, hard = self._matrices, self.own[~self._soft]
        found = self._curved(step) + matrices.jacobian.T @ rows
        held = matrices.jacobian @ step - matrices.softness * rows
        found[self.decided] += self._shift * step[self.decided]
        held[hard] -= self._row_shift * rows[hard]
        return found, held

    def _solved(self, by_variables: np.ndarray, by_rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One solution by elimination."""
        soft, own, jacobian = self._soft, self.own, self._matrices.jacobian
        step, rows = np.zeros(by_variables.size), np.zeros(by_rows.size)
        step[self._tied] = self._factors.solve(by_rows[self._tied_rows][:, None])[:, 0]
        rest = self._moves.T @ (by_variables - self._curved(step))
        left = by_rows[own] - self._own_jacobian @ step
        pushed = left[soft] / self._softness[soft]
        found = self._inverse @ np.concatenate([rest + self._slopes[soft].T @ pushed, left[~soft]])
        decided, hard = np.split(found, [self.decided.size])
        rows[own[~soft]] = hard
        rows[own[soft]] = (self._slopes[soft] @ decided - left[soft]) / self._softness[soft]
        step += self._moves @ decided
        pull = (by_variables - self._curved(step) - jacobian.T @ rows)[self._tied]
        rows[self._tied_rows] = self._factors.solve_transposed(pull[:, None])[:, 0]
        return step, rows


def _size(parts: tuple[np.ndarray, np.ndarray]) -> float:
    return float(max(np.abs(part).max(initial=0.0) for part in parts))
