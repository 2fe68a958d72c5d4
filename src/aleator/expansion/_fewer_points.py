"""Least squares at some of the points that were planned, because the others have no samples."""

import numpy as np
from jaxtyping import Bool

from aleator._core.errors import ProblemError
from aleator.expansion._basis import Basis
from aleator.expansion._collocation import Collocation
from aleator.expansion._fit import AbstractFit, LeastSquares
from aleator.expansion._points import Nodes

# By how much missing points may multiply the condition number: one digit.
_WORSE = 10.0


def at_fewer_points(
    basis: Basis, collocation: Collocation, fit: AbstractFit, kept: Bool[np.ndarray, " points"]
) -> Collocation:
    """The collocation at the points that are kept, with their weights relative to one another.

    Raises `ProblemError` for a fit other than least squares, if fewer points than terms are kept, or if the condition
    number grows more than tenfold: then nothing but extrapolation tells what the outputs do where points are missing.
    """
    missing = f"{np.count_nonzero(~kept)} of {len(kept)} samples are missing"
    if not isinstance(fit, LeastSquares):
        raise ProblemError(
            f"{missing}, but {type(fit).__name__} needs all of them: take al.fits.LeastSquares(), or complete them."
        )
    terms, remaining = basis.terms, int(np.count_nonzero(kept))
    if remaining < terms:
        raise ProblemError(f"{missing}, and {remaining} do not determine {terms} terms. Complete them.")
    weights = np.asarray(collocation.weights)[kept]
    fewer = fit.collocation(basis, Nodes(np.asarray(collocation.points)[kept], weights / weights.sum()))
    before, after = float(collocation.condition_number), float(fewer.condition_number)
    if not after <= _WORSE * before:
        raise ProblemError(
            f"{missing}, which raises the condition number of least squares from {before:.3g} to {after:.3g} (limit "
            f"{_WORSE:g} times as large): the expansion would only extrapolate there. Complete them, lower the order, "
            "or narrow the distributions."
        )
    return fewer
