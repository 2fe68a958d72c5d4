"""Functions of NumPy with derivatives as functions of JAX: called back, and differentiated by a rule of their own."""

import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.errors import SimulationError, SimulationWarning
from aleator.foreign._fmu._library import LOCK

Host: TypeAlias = Callable[[Float[np.ndarray, " n"]], np.ndarray]
"""A function of a vector of known numbers."""


def called_back(value: Host, jacobian: Host, hessian: Host, size: int) -> Callable[[Float[Array, " n"]], Array]:
    """A function of JAX of a vector, with `size` values; `jacobian` and `hessian` have one and two axes more.

    First and second derivatives exist in all modes, and batches are evaluated point by point. Where the FMU fails,
    values and derivatives are NaN, and a `SimulationWarning` says why: an exception would end a search that may well
    turn back.
    """

    @jax.custom_jvp
    def slopes(z: Float[Array, " n"]) -> Array:
        return _call(jacobian, z, (size, len(z)))

    @slopes.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        ((z,), (change,)) = primals, tangents
        return slopes(z), _call(hessian, z, (size, len(z), len(z))) @ change

    @jax.custom_jvp
    def function(z: Float[Array, " n"]) -> Array:
        return _call(value, z, (size,))

    @function.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        ((z,), (change,)) = primals, tangents
        return function(z), slopes(z) @ change

    return function


def _call(host: Host, z: Float[Array, " n"], shape: tuple[int, ...]) -> Array:
    def batch(points: Any) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        found = np.empty((*points.shape[:-1], *shape))
        for index in np.ndindex(points.shape[:-1]):
            found[index] = _or_nan(host, points[index], shape)
        return found

    return jax.pure_callback(batch, jax.ShapeDtypeStruct(shape, float), z, vmap_method="expand_dims")


def _or_nan(host: Host, point: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if not np.isfinite(point).all():
        return np.full(shape, np.nan)
    try:
        with LOCK:
            return host(point)
    except SimulationError as error:
        warnings.warn(str(error), SimulationWarning, stacklevel=2)
        return np.full(shape, np.nan)
