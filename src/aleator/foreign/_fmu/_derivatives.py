"""Derivatives: by differences, for what offers none; and functions of NumPy with derivatives as functions of JAX."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from aleator._core.errors import SimulationError, SimulationWarning

# Relative to a number's scale. The error of the formula, of the fourth order of the step, is about 1e-12 of a smooth
# function; noise of a solver is magnified by about a thousand only.
STEP = 1e-3
# After the place: coefficients of a difference over so many steps.
_FORWARD = {0: -25 / 12, 1: 48 / 12, 2: -36 / 12, 3: 16 / 12, 4: -3 / 12}
Host: TypeAlias = Callable[[float, Float[np.ndarray, " n"]], np.ndarray]
"""A function of a time and a vector of known numbers."""
# By time they are differentiated over such a step, s, after it alone: there may be nothing before the start. What
# changes within a millisecond is differentiated to five digits.
_LATER = 1e-5


class Slope(NamedTuple):
    """A derivative, and how much the differences over one step and over two disagree: much if noise or jumps do."""

    value: np.ndarray
    disagreement: np.ndarray


def scales(values: Float[np.ndarray, " n"], nominals: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """By how much a change of each number is large: its size, or what is usual where it is about zero."""
    return np.where(np.abs(values) > 1e-6 * nominals, np.abs(values), nominals)


def slope(along: Callable[[float], np.ndarray], step: float) -> Slope:
    """The derivative at zero of `along`, a function of a number, by four points about zero, of fourth order."""
    once = (along(step) - along(-step)) / (2 * step)
    twice = (along(2 * step) - along(-2 * step)) / (4 * step)
    return Slope((4 * once - twice) / 3, np.abs(once - twice))


def forward_slope(along: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """The same, asking for positive numbers alone."""
    return np.sum([weight * along(count * step) for count, weight in _FORWARD.items()], axis=0) / step


def difference_jacobian(
    function: Callable[[np.ndarray], np.ndarray], at: Float[np.ndarray, " n"], steps: Float[np.ndarray, " n"]
) -> Slope:
    """The derivatives of an array by each number of `at`, on a last axis."""
    if not len(at):
        nothing = np.zeros((*np.shape(function(at)), 0))
        return Slope(nothing, nothing)
    units = np.eye(len(at))
    columns = [
        slope(lambda a, unit=unit: function(at + a * unit), step) for unit, step in zip(units, steps, strict=True)
    ]
    return Slope(*(np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)))


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
