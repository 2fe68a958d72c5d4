"""Second derivatives by differences of first ones: a few more evaluations where an approximation gets no further."""

from collections.abc import Callable
from typing import final

import numpy as np
import scipy.sparse

from aleator.nlp._evaluations import NotFiniteError
from aleator.nlp._matrices import SparseMatrix, entries
from aleator.nlp._program import Evaluation

# Most variables for which second derivatives are taken from differences of first ones, one evaluation for each.
MOST_DIFFERENCED = 30
# Size of a step in typical magnitudes of the variable.
_STEP = 1e-5
# So many points, one of them so many typical magnitudes away from the first, show that nothing curves.
_POINTS, _AWAY = 10, 1e-2
# Slopes that differ by less than this part of themselves, or of the largest, are the same.
_SAME, _NOTHING = 1e-12, 1e-13


@final
class Straightness:
    """Whether all slopes seen so far were the same, as those of a linear program.

    Approximations of second derivatives learn from changes of slopes: where there are none, every step remains as
    short as the first.
    """

    def __init__(self) -> None:
        self._points, self._far, self._curved = 0, False, False
        self._first: tuple[np.ndarray, np.ndarray] | None = None

    def note(self, z: np.ndarray, user: Evaluation) -> None:
        """Take a further point into account, shape (n_free,), with its evaluation."""
        if self._curved:
            return
        slopes = np.concatenate([user.gradient, np.ravel(entries(user.jacobian))])
        if self._first is None:
            self._first = z, slopes
        start, first = self._first
        allowed = _SAME * np.abs(first) + _NOTHING * np.abs(first).max(initial=0.0)
        self._curved = bool(np.any(np.abs(slopes - first) > allowed))
        self._points += 1
        self._far = self._far or bool(np.any(np.abs(z - start) > _AWAY))

    @property
    def is_shown(self) -> bool:
        """Whether enough points were seen, and all of them had the same slopes."""
        return not self._curved and self._far and self._points >= _POINTS


def lower_triangle(size: int) -> SparseMatrix:
    """All entries of a lower triangle; those of the diagonal alone where differences would take too long."""
    if size > MOST_DIFFERENCED:
        return scipy.sparse.csr_array(scipy.sparse.eye_array(size))
    return scipy.sparse.csr_array(np.tril(np.ones((size, size))))


def differenced(
    evaluate: Callable[[np.ndarray], Evaluation],
    z: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    weight: float,
    multipliers: np.ndarray,
) -> np.ndarray:
    """The entries of the lower triangle of the second derivatives of `weight f + multipliersᵀ c`, row by row.

    `z`: shape (n_free,), with its `bounds`. Raises `NotFiniteError` where the model has no value on either side.
    """

    def slope(point: np.ndarray) -> np.ndarray:
        found = evaluate(point)
        return weight * found.gradient + multipliers @ found.jacobian

    here = slope(z)
    columns = np.zeros((z.size, z.size))
    for which in range(z.size):
        there = _neighbour(z, which, *bounds, sign=1.0)
        try:
            change = slope(there) - here
        except NotFiniteError:
            there = _neighbour(z, which, *bounds, sign=-1.0)
            change = slope(there) - here
        length = there[which] - z[which]
        columns[which] = change / length if length else 0.0
    return ((columns + columns.T) / 2)[np.tril_indices(z.size)]


def _neighbour(z: np.ndarray, which: int, lower: np.ndarray, upper: np.ndarray, sign: float) -> np.ndarray:
    """A point beside `z` within the bounds: on the other side if there is no room on that of `sign`."""
    step = _STEP * max(1.0, abs(float(z[which])))
    room = upper[which] - z[which] if sign > 0 else z[which] - lower[which]
    moved = z.copy()
    moved[which] += sign * step if room >= step else -sign * step
    return np.clip(moved, lower, upper)
