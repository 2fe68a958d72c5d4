"""Programs that limit the peaks of a path between the rows that sample it, and its ends behind them.

A limit at samples alone is exceeded between them. Were its bound tightened by that much, a multiplier would be no slope
of the optimum: the excess depends on the design. A parabola through three rows follows its peak instead, and one
through the last rows before a jump the value there.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator.nlp._program import Evaluation, Hessian, Matrix, NonlinearProgram, SparseMatrix, with_entries


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
    middles, hessian = np.array([one.rows[1] for one in peaks]), program.hessian
    mix = _Mix(peaks, program)

    def moved(constraints: np.ndarray, every: Sequence[Extreme]) -> np.ndarray:
        changed = constraints.copy()
        changed[middles] = [one.value for one in every]
        return changed

    def evaluate(x: np.ndarray) -> Evaluation:
        own = program.evaluate(x)
        every = [one.at(own.constraints) for one in peaks]
        jacobian = mix.of(own.jacobian, np.concatenate([one.weights for one in every]))
        return own._replace(constraints=moved(own.constraints, every), jacobian=jacobian)

    def values(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert program.values is not None
        objectives, rows = program.values(points)
        return objectives, np.stack([moved(own, [one.at(own) for one in peaks]) for own in rows])

    return replace(
        program,
        evaluate=evaluate,
        sparsity=mix.sparsity,
        hessian=None if hessian is None else _curved(program, hessian, peaks),
        values=values if program.values else None,
    )


@final
class _Mix:
    """Jacobians whose middle rows are weighted sums of three; `sparsity`: theirs."""

    def __init__(self, peaks: Sequence[Peak | End], program: NonlinearProgram):
        count, width, sparsity = len(program.constraint_lower), program.start.size, program.sparsity
        self._rows = np.array([one.rows for one in peaks])
        self.sparsity = sparsity
        if isinstance(sparsity, np.ndarray):
            self.sparsity = sparsity.copy()
            self.sparsity[self._rows[:, 1]] = sparsity[self._rows].any(axis=1)
        elif sparsity is not None:
            others = np.setdiff1d(np.arange(count), self._rows[:, 1])
            into, of = np.append(others, np.repeat(self._rows[:, 1], 3)), np.append(others, self._rows)
            lengths = np.diff(sparsity.indptr)[of]
            # The entries of all these rows one after the other, and of which row each is.
            self._row = np.repeat(np.arange(len(of)), lengths)
            self._entries = np.arange(len(self._row)) + (sparsity.indptr[of] - np.cumsum(lengths) + lengths)[self._row]
            keys = into[self._row] * width + sparsity.indices[self._entries]
            keys, self._into = np.unique(keys, return_inverse=True)
            self._others, self.sparsity = len(others), _pattern(keys, (count, width))
            self._count = len(keys)

    def of(self, jacobian: Matrix, weights: Float[np.ndarray, " rows"]) -> Matrix:
        """That of a Jacobian, with the weights of all peaks."""
        if isinstance(jacobian, np.ndarray):
            mixed = jacobian.copy()
            mixed[self._rows[:, 1]] = np.einsum("pk,pkn->pn", weights.reshape(-1, 3), jacobian[self._rows])
            return mixed
        numbers = np.append(np.ones(self._others), weights)[self._row] * jacobian.data[self._entries]
        return with_entries(self.sparsity, np.bincount(self._into, numbers, self._count))


def _pattern(keys: Int[np.ndarray, " entries"], shape: tuple[int, int]) -> SparseMatrix:
    """The sparsity with entries at `row * columns + column`, in order."""
    ends = np.searchsorted(keys, np.arange(shape[0] + 1) * shape[1])
    return scipy.sparse.csr_array((np.ones(len(keys), dtype=bool), keys % shape[1], ends), shape=shape)


def _curved(program: NonlinearProgram, hessian: Hessian, every: Sequence[Peak | End]) -> Hessian:
    """Second derivatives with those of the peaks."""
    size, peaks = program.start.size, [one for one in every if isinstance(one, Peak)]

    def keys_of(matrix: SparseMatrix) -> Int[np.ndarray, " entries"]:
        return np.repeat(np.arange(size), np.diff(matrix.indptr)) * size + matrix.indices

    def columns_of(one: Peak) -> Int[np.ndarray, " some"]:
        if isinstance(program.sparsity, np.ndarray | None):
            return np.arange(size)
        return np.unique(program.sparsity[one.rows].indices)

    lowers = [(columns_of(one), *np.tril_indices(len(columns_of(one)))) for one in peaks]
    own = [columns[rows] * size + columns[others] for columns, rows, others in lowers]
    keys = np.unique(np.concatenate([keys_of(hessian.sparsity), *own]))
    sparsity = _pattern(keys, (size, size))
    begun, *places = (np.searchsorted(keys, one) for one in (keys_of(hessian.sparsity), *own))

    def evaluate(x: np.ndarray, weight: float, multipliers: np.ndarray) -> SparseMatrix:
        here, of_rows, numbers = program.evaluate(x), multipliers.copy(), np.zeros(len(keys))
        of_rows[[one.rows[1] for one in every]] = 0.0
        for one in every:  # a straight line has one of two rows twice
            np.add.at(of_rows, one.rows, multipliers[one.rows[1]] * one.at(here.constraints).weights)
        for peak, (columns, rows, others), where in zip(peaks, lowers, places, strict=True):
            one, multiplier = peak.at(here.constraints), multipliers[peak.rows[1]]
            along = np.asarray(one.moving @ here.jacobian[peak.rows])[columns]
            numbers[where] += multiplier * one.bend * along[rows] * along[others]
        numbers[begun] += hessian.evaluate(x, weight, of_rows).data
        return with_entries(sparsity, numbers)

    return Hessian(evaluate, sparsity)
