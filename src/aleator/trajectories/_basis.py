"""B-spline bases: the Cox-de Boor recursion, and matrices from control points to values and derivatives."""

from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float


def clamped(interior: Any, degree: int) -> Any:
    """The knots of a clamped spline over [0, 1]: each end `degree + 1` times, with the interior knots in between."""
    xp = _library(interior)
    return xp.concatenate([xp.zeros(degree + 1), xp.asarray(interior), xp.ones(degree + 1)])


def basis(u: Any, knots: Any, degree: int) -> Any:
    """All basis functions at the points `u`, by the Cox-de Boor recursion (equation 53): shape (points, functions).

    The first and the last interval extend beyond the ends, since rounding may put a point there.
    """
    xp = _library(u, knots)
    u, knots = xp.asarray(u)[:, None], xp.asarray(knots)
    left, right = knots[:-1][None], knots[1:][None]
    within = ((u >= left) | (left <= knots[0])) & ((u < right) | (right >= knots[-1]))
    found = xp.where(within & (left < right), 1.0, 0.0)
    for p in range(1, degree + 1):
        rising = _ratio(xp, u - knots[: -p - 1][None], (knots[p:-1] - knots[: -p - 1])[None])
        falling = _ratio(xp, knots[p + 1 :][None] - u, (knots[p + 1 :] - knots[1:-p])[None])
        found = rising * found[:, :-1] + falling * found[:, 1:]
    return found


def differences(knots: Any, degree: int) -> Any:
    """The matrix from a spline's control points to those of its derivative (equation 54): (n - 1, n)."""
    xp = _library(knots)
    knots = xp.asarray(knots)
    n = len(knots) - degree - 1
    slopes = degree / (knots[degree + 1 : -1] - knots[1 : -degree - 1])
    return slopes[:, None] * (xp.eye(n)[1:] - xp.eye(n)[:-1])


def derived(knots: Any, degree: int, order: int) -> Any:
    """The matrix from a spline's control points to those of its derivative of some order: (n - order, n)."""
    xp = _library(knots)
    found = xp.eye(len(knots) - degree - 1)
    for done in range(order):
        inner = knots[done : len(knots) - done]
        found = differences(inner, degree - done) @ found
    return found


def matrix(u: Any, knots: Any, degree: int, order: int = 0) -> Any:
    """From control points to the derivative of some order at the points `u`: shape (points, control points)."""
    if order > degree:
        return np.zeros((len(u), len(knots) - degree - 1))
    inner = knots[order : len(knots) - order]
    return basis(u, inner, degree - order) @ derived(knots, degree, order)


@lru_cache(maxsize=256)
def _fixed_matrix(u: bytes, knots: tuple[float, ...], degree: int, order: int) -> Float[np.ndarray, "points n"]:
    return matrix(np.frombuffer(u), np.array(knots), degree, order)


def basis_matrix(u: Any, knots: tuple[float, ...] | Array, degree: int, order: int) -> Any:
    """The same as `matrix`, but cached for plain points and fixed knots, where it is a constant of the compiled
    program.
    """
    if isinstance(u, np.ndarray) and isinstance(knots, tuple):
        return _fixed_matrix(np.ascontiguousarray(u, dtype=float).tobytes(), knots, degree, order)
    return matrix(u, jnp.asarray(knots), degree, order)


def _library(*arrays: Any) -> Any:
    """NumPy for plain arrays, JAX for its own: one recursion serves both."""
    return jnp if any(isinstance(one, Tracer | Array) for one in arrays) else np


def _ratio(xp: Any, numerator: Any, denominator: Any) -> Any:
    """`numerator / denominator`, and 0 where knots coincide."""
    proper = denominator > 0
    return xp.where(proper, numerator / xp.where(proper, denominator, 1.0), 0.0)
