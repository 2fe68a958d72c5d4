"""Functions of NumPy with derivatives as functions of JAX: called back, and differentiated by a rule of their own."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from aleator._core.errors import SimulationError, SimulationWarning
from aleator.foreign._fmu._differences import forward_slope

Host: TypeAlias = Callable[[float, Float[np.ndarray, " n"]], np.ndarray]
"""A function of a time and a vector of known numbers."""

# By time they are differentiated over such a step, s, after it alone: there may be nothing before the start. What
# changes within a millisecond is differentiated to five digits.
_LATER = 1e-5


class Evaluations(NamedTuple):
    """A function of a time and a vector, with `size` values; `jacobian` and `hessian` have one and two axes more."""

    value: Host
    jacobian: Host
    hessian: Host
    size: int


def called_back(of: Evaluations) -> Callable[[Any, Float[Array, " n"]], Array]:
    """A function of JAX of a time and a vector.

    First and second derivatives exist in all modes, and batches are evaluated point by point. Derivatives by time, by
    differences, cost nothing where the time is not differentiated. Where the FMU fails, values and derivatives are
    NaN, and a `SimulationWarning` says why: an exception would end a search that may well turn back.
    """
    function = _function((of.value, of.jacobian, of.hessian), (of.size,))
    return lambda t, z: function(jnp.asarray(t, dtype=float), z)


def _function(hosts: tuple[Host, ...], shape: tuple[int, ...]) -> Any:
    """The first of some hosts, each the derivative by the vector of the one before, as a function of JAX."""
    value, *others = hosts

    def function(t: Float[Array, ""], z: Float[Array, " n"]) -> Array:
        return _call(value, t, z, shape)

    if not others:
        return function
    differentiable = jax.custom_jvp(function)
    by_time = _function(tuple(map(_by_time, hosts[:-1])), shape)

    def rule(primals: Any, tangents: Any) -> Any:
        (t, z), (later, change) = primals, tangents
        found = differentiable(t, z)
        moved = jnp.zeros_like(found)
        if not isinstance(change, SymbolicZero):
            moved = moved + _function(tuple(others), (*shape, len(z)))(t, z) @ change
        if not isinstance(later, SymbolicZero):
            moved = moved + by_time(t, z) * later
        return found, moved

    differentiable.defjvp(rule, symbolic_zeros=True)
    return differentiable


def _by_time(host: Host) -> Host:
    return lambda t, z: forward_slope(lambda later: host(t + later, z), _LATER)


def _call(host: Host, t: Float[Array, ""], z: Float[Array, " n"], shape: tuple[int, ...]) -> Array:
    def batch(points: Any) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        found = np.empty((*points.shape[:-1], *shape))
        for index in np.ndindex(points.shape[:-1]):
            found[index] = _or_nan(host, points[index], shape)
        return found

    point = jnp.concatenate([t[None], z])
    return jax.pure_callback(batch, jax.ShapeDtypeStruct(shape, float), point, vmap_method="expand_dims")


def _or_nan(host: Host, point: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if not np.isfinite(point).all():
        return np.full(shape, np.nan)
    try:
        return host(float(point[0]), point[1:])
    except SimulationError as error:
        warnings.warn(str(error), SimulationWarning, stacklevel=2)
        return np.full(shape, np.nan)
