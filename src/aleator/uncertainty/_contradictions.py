"""Checks that the methods of a user's own distribution agree: its germ, its moments and support, and `from_normal`."""

from typing import Any

import jax
import numpy as np
import scipy

from aleator._core.errors import ProblemError

# Probability levels that are compared, and the tolerance as a fraction of the spread.
_LEVELS = np.array([0.02, 0.16, 0.5, 0.84, 0.98])
_SAME = 1e-6


def refuse_contradictions(distribution: Any) -> None:
    """Raise `ProblemError`, naming the method, where two methods of a distribution of plain numbers disagree."""
    with jax.ensure_compile_time_eval():
        location, scale, shape = distribution.canonical()
        germ = distribution.germ()
        a, b = germ.recurrence(1)
        low, high = germ.support()
        quantiles = np.asarray(germ.quantile(_LEVELS), dtype=float)
        normal = [float(distribution.from_normal(np.asarray(one), shape)) for one in scipy.special.ndtri(_LEVELS)]
        said = {
            f"from_normal at the levels {_LEVELS.tolist()}": (normal, quantiles),
            "mean": (distribution.mean(), location + scale * a[0]),
            "std": (distribution.std(), scale * b[1]),
            "support": (distribution.support(), (location + scale * low, location + scale * high)),
        }
    for name, (given, expected) in said.items():
        given, expected = np.asarray(given, dtype=float), np.asarray(expected, dtype=float)
        size = 1.0 if name.startswith("from_normal") else abs(float(scale))
        if not (given.shape == expected.shape and np.allclose(given, expected, rtol=_SAME, atol=_SAME * size)):
            raise ProblemError(
                f"{type(distribution).__name__}: its germ and its {name} contradict each other: expected "
                f"{_brief(expected)} by germ(); received {_brief(given)}."
            )


def _brief(values: np.ndarray) -> str:
    return ", ".join(f"{one:.6g}" for one in np.ravel(values))
