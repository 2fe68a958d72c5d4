"""How statistics of third and fourth powers change as collocation points are left out, one at a time.

The leave-one-out error is one of values, to which mean and spread owe theirs. High powers of polynomials may instead
owe theirs to tails so far out that no point is near: there each point that is left out makes them another number.
"""

import warnings
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.errors import ExpansionWarning
from aleator._core.leaves import is_traced
from aleator.expansion import Collocation, left_out
from aleator.statistics import AbstractStatistic, CornishFisher, Kurtosis, Skewness, Std

# Points that are left out at most, those that change most; the products of coefficients that these may take in all.
_MOST, _PRODUCTS = 64, 10**8
# The change that is told, as a part of the statistic, of one at least, or of a spread. An entry of a path varies if its
# spread is more than this part of the largest.
_TOLD, _NEGLIGIBLE = 0.1, 1e-6


def with_points_left_out(
    kind: AbstractStatistic,
    collocation: Collocation | None,
    samples: Any,
    terms: Float[Array, "terms *shape"],
    constants: Any,
) -> Float[np.ndarray, "terms some *shape"] | None:
    """The coefficients, and those without one of the points each.

    None for other statistics, where the numbers are being traced, and where it would take long.
    """
    if collocation is None or not isinstance(kind, Skewness | Kurtosis | CornishFisher):
        return None
    if any(map(is_traced, (samples, terms, collocation.points))):
        return None
    known = np.asarray(terms)
    most = min(_PRODUCTS // max(constants.values.size * known[0].size, 1), _MOST)
    return np.concatenate([known[:, None], left_out(collocation, np.asarray(samples), known, most)], axis=1)


def warn_of_shape(
    kind: AbstractStatistic, values: Float[np.ndarray, "some *shape"], terms: Float[np.ndarray, "terms *shape"]
) -> None:
    """Warn (`ExpansionWarning`) of a statistic with an error by the jackknife that one would act on."""
    value, std = values[0], np.asarray(Std().of(jax_array(terms), ()))
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.sqrt(np.sum((values[1:] - value) ** 2, axis=0))
    size = std if isinstance(kind, CornishFisher) else np.maximum(np.abs(value), 1.0)
    told = ~(error <= _TOLD * size) & (std > _NEGLIGIBLE * np.max(std, initial=0.0))
    if told.any():
        worst = np.unravel_index(int(np.argmax(np.where(told, error / size, 0.0))), value.shape)
        warnings.warn(
            f"{kind.text('output')} of the expansion is {value[worst]:.3g} ± {error[worst]:.1g} by the jackknife: it "
            "hangs on tails that no collocation point is near. Raise the order, or take al.references.monte_carlo.",
            ExpansionWarning,
            stacklevel=4,
        )
