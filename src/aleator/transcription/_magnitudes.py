"""Typical magnitudes of decisions and constraints, and other decisions of such magnitudes."""

from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from aleator.design import Constraint

Values: TypeAlias = Sequence[Float[np.ndarray, "..."]]
"""Rows of each constraint, whose number differs from one to the next."""

# How many decisions all over their range tell whether a constraint depends on them.
_TRIED = 8


def constraint_scales(
    constraints: Iterable[Constraint], values: Values, derivatives: Values, decision_scale: Float[np.ndarray, " n"]
) -> list[float]:
    """A typical magnitude of each constraint: its smaller bound, or its change over a typical change of the decisions.

    The larger of the two counts. A remote second bound says nothing of the size, nor does a bound of zero.
    """
    scales = []
    for one, value, slopes in zip(constraints, values, derivatives, strict=True):
        bounds = [abs(float(bound)) for bound in (one.lower, one.upper) if np.isfinite(bound) and bound != 0]
        change = float(np.max(np.abs(slopes) @ decision_scale, initial=0.0))
        known = [size for size in (min(bounds, default=0.0), change) if np.isfinite(size)]
        fallback = float(np.max(np.abs(value), initial=0.0))
        scales.append(max(known) or (fallback if np.isfinite(fallback) else 0.0) or 1.0)
    return scales


def decision_scales(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Float[np.ndarray, " n"]:
    """A typical magnitude of each decision: its start, or a tenth of its range if that is larger."""
    span = upper - lower
    scale = np.maximum(np.abs(start), np.where(np.isfinite(span), 0.1 * span, 0.0))
    return np.where(scale > 0, scale, 1.0)


def elsewhere(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[Float[np.ndarray, " n"]]:
    """Decisions near the start and all over their range: what is the same at all of them is moved by none."""
    rng = np.random.default_rng(0)
    size = decision_scales(start, lower, upper)
    low, high = np.maximum(lower, start - 3 * size), np.minimum(upper, start + 3 * size)
    low, high = np.where(np.isfinite(lower), lower, low), np.where(np.isfinite(upper), upper, high)
    near = np.clip(start + 1e-2 * rng.choice([-1.0, 1.0], start.shape), lower, upper)
    return [near, *rng.uniform(low, high, (_TRIED, len(start)))]
