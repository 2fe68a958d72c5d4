"""The linear system of an interior-point step, condensed to the variables that no tie determines.

The tied variables follow from the others by the linearised ties, whatever the curvature is. What is left is dense and
small, and its eigenvalues say exactly whether the step is one towards a minimum: the inertia of the whole matrix is
that of the rest plus as many positive as negative eigenvalues as there are ties (Nocedal and Wright 2006, section
16.3). Unlike a factorisation of the whole, this loses digits where ties amplify errors, as unstable realisations do.
"""

from typing import NamedTuple, final

import numpy as np

from aleator.nlp._elimination import Elimination, Factors
from aleator.nlp._matrices import SparseMatrix

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
