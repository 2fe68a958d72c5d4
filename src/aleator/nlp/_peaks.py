"""Programs that limit the peaks of a path between the rows that sample it, and its ends behind them.

A limit at samples alone is exceeded between them. Were its bound tightened by that much, a multiplier would be no slope
of the optimum: the excess depends on the design. A parabola through three rows follows its peak instead, and one
through the last rows before a jump the value there.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator.nlp._matrices import Matrix, SparseMatrix, spread, weighted_rows, with_entries
from aleator.nlp._program import Evaluation, Hessian, NonlinearProgram


class Peak(NamedTuple):
    """Three neighbouring rows and their places. The middle one limits the highest value of the parabola through all of
    them, between the outer ones, if `side` is 1, and the lowest if it is -1.
    """

    rows: Int[np.ndarray, " 3"]
    places: Float[np.ndarray, " 3"]
    side: int

    def at(self, constraints: Float[np.ndarray, " m"]) -> "Extreme":
        """What it limits."""
        return extreme(self.places, constraints[self.rows], self.side)


class End(NamedTuple):
    """Three rows and their weights. The middle one limits the weighted sum, what they tell of the path elsewhere."""

    rows: Int[np.ndarray, " 3"]
    weights: Float[np.ndarray, " 3"]

    @classmethod
    def of(cls, rows: Int[np.ndarray, " some"], places: Float[np.ndarray, " rows"], end: float) -> "End":
        """The value at an `end` by the parabola through three rows, or by the straight line through two; the first of
        them limits it.

        - `places`: of all rows.
        """
        weights = np.zeros(3)
        for i, own in enumerate(rows):
            others = places[np.delete(rows, i)]
            weights[i] = np.prod((end - others) / (places[own] - others))
        return cls(rows[[1, 0, -1]], weights[[1, 0, 2]])

    def at(self, constraints: Float[np.ndarray, " m"]) -> "Extreme":
        """What it limits."""
        return Extreme(float(self.weights @ constraints[self.rows]), self.weights, np.zeros(3), 0.0)


class Extreme(NamedTuple):
    """The highest or lowest value of a parabola through three values, and its derivatives by these.

    - `value`; `weights`: its first derivatives, whose sum is 1;
    - `moving`, `bend`: its second derivatives are `bend moving movingᵀ`, since the extreme moves.
    """

    value: float
    weights: Float[np.ndarray, " 3"]
    moving: Float[np.ndarray, " 3"]
    bend: float


def extreme(places: Float[np.ndarray, " 3"], values: Float[np.ndarray, " 3"], side: int) -> Extreme:
    """The highest value between the outer places if `side` is 1, the lowest if it is -1."""
    before, _, after = places - places[1]
    first, last = np.array([1.0, -1.0, 0.0]) / before, np.array([0.0, -1.0, 1.0]) / after
    # The parabola is `c + slope s + curve s²`.
    curve = (last - first) / (after - before)
    slope = first - curve * before
    steep, bent = float(slope @ values), float(curve @ values)
    if side * bent < 0 and before < (inside := -steep / (2 * bent)) < after:
        place, bend = inside, -1 / (2 * bent)
    else:
        place, bend = before if side * (values[0] - values[2]) > 0 else after, 0.0
    weights = np.array([0.0, 1.0, 0.0]) + place * slope + place**2 * curve
    return Extreme(float(weights @ values), weights, slope + 2 * place * curve, bend)


def with_peaks(program: NonlinearProgram, peaks: Sequence[Peak | End]) -> NonlinearProgram:
    """The program in which the middle rows of some peaks and ends limit these."""
    rows, sparsity, hessian = np.array([one.rows for one in peaks]), program.sparsity, program.hessian
    middles = rows[:, 1]

    def extremes(constraints: np.ndarray) -> list[Extreme]:
        return [one.at(constraints) for one in peaks]

    def moved(constraints: np.ndarray, every: Sequence[Extreme]) -> np.ndarray:
        changed = constraints.copy()
        changed[middles] = [one.value for one in every]
        return changed

    def evaluate(x: np.ndarray) -> Evaluation:
        own = program.evaluate(x)
        every = extremes(own.constraints)
        jacobian = _mixed(own.jacobian, rows, np.array([one.weights for one in every]), sparsity)
        return own._replace(constraints=moved(own.constraints, every), jacobian=jacobian)

    def values(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert program.values is not None
        objectives, constraints = program.values(points)
        return objectives, np.stack([moved(own, extremes(own)) for own in constraints])

    if isinstance(sparsity, np.ndarray):
        sparsity = sparsity.copy()
        sparsity[middles] = sparsity[rows].any(axis=1)
    elif sparsity is not None:
        sparsity = (_mixing(rows, np.ones(rows.shape), sparsity.shape[0]) @ sparsity).astype(bool)
        sparsity.sort_indices()
    return replace(
        program,
        evaluate=evaluate,
        sparsity=sparsity,
        hessian=None if hessian is None else _curved(program, hessian, rows, extremes),
        values=values if program.values else None,
    )


def _mixing(rows: Int[np.ndarray, "peaks 3"], weights: Float[np.ndarray, "peaks 3"], count: int) -> SparseMatrix:
    """The square matrix that leaves all rows but the middle ones, which become weighted sums of three."""
    others = np.setdiff1d(np.arange(count), rows[:, 1])
    into, of = np.append(others, np.repeat(rows[:, 1], 3)), np.append(others, rows)
    return scipy.sparse.csr_array((np.append(np.ones(len(others)), weights), (into, of)), shape=(count, count))


def _mixed(
    jacobian: Matrix, rows: Int[np.ndarray, "peaks 3"], weights: Float[np.ndarray, "peaks 3"], sparsity: Matrix | None
) -> Matrix:
    """A Jacobian whose middle rows are weighted sums of three; `sparsity`: its own, if it is sparse."""
    if not isinstance(jacobian, np.ndarray):
        return spread(sparsity, _mixing(rows, weights, len(jacobian.indptr) - 1) @ jacobian)
    mixed = jacobian.copy()
    mixed[rows[:, 1]] = np.einsum("pk,pkn->pn", weights, jacobian[rows])
    return mixed


def _curved(
    program: NonlinearProgram,
    hessian: Hessian,
    rows: Int[np.ndarray, "peaks 3"],
    extremes: Callable[[np.ndarray], list[Extreme]],
) -> Hessian:
    """Second derivatives with those of the peaks."""
    count, size = program.constraint_lower.size, program.start.size
    felt = np.ones((count, size), dtype=bool) if program.sparsity is None else program.sparsity

    def along(movings: Float[np.ndarray, "peaks 3"], matrix: Matrix) -> SparseMatrix:
        """How each peak moves with the variables."""
        places = np.repeat(np.arange(len(rows)), 3), rows.ravel()
        return scipy.sparse.csr_array(
            scipy.sparse.csr_array((movings.ravel(), places), shape=(len(rows), count)) @ matrix
        )

    def lower(bends: Float[np.ndarray, " peaks"], moving: SparseMatrix) -> SparseMatrix:
        return scipy.sparse.tril(moving.T @ weighted_rows(bends, moving), format="csr")

    curved = lower(np.ones(len(rows)), along(np.ones(rows.shape), felt))
    sparsity = (curved + hessian.sparsity).astype(bool)
    sparsity.sort_indices()

    def evaluate(x: np.ndarray, weight: float, multipliers: np.ndarray) -> SparseMatrix:
        here, of_rows, pushes = program.evaluate(x), multipliers.copy(), multipliers[rows[:, 1]]
        every = extremes(here.constraints)
        of_rows[rows[:, 1]] = 0.0
        # A straight line has one of two rows twice.
        np.add.at(of_rows, rows, pushes[:, None] * [one.weights for one in every])
        moving = along(np.array([one.moving for one in every]), here.jacobian)
        own = spread(sparsity, hessian.evaluate(x, weight, of_rows))
        bent = spread(sparsity, lower(pushes * [one.bend for one in every], moving))
        return with_entries(sparsity, own.data + bent.data)

    return Hessian(evaluate, sparsity)
