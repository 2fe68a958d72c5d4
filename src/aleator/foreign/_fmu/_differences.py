"""Functions of NumPy as functions of JAX, with derivatives of any order by differences."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

Host: TypeAlias = Callable[[Float[np.ndarray, "points m"]], np.ndarray]
"""Values at some points, shape (points, ...): each is a time and then numbers."""
Steps: TypeAlias = Callable[[Float[np.ndarray, "points n"]], Float[np.ndarray, "points n"]]
"""The step of a difference by each number."""
Judge: TypeAlias = Callable[[np.ndarray, np.ndarray], None]
"""Takes derivatives and by how much those over one step and over two disagree: much if noise or jumps do."""

_ABOUT = np.array([-2.0, -1.0, 1.0, 2.0])
# By time, values are asked for after it alone: there may be nothing before the start. Weights by the count of steps, s.
# What changes within a millisecond is differentiated to five digits.
_LATER, _WEIGHTS = 1e-5, (-25 / 12, 48 / 12, -36 / 12, 16 / 12, -3 / 12)


def relative_steps(part: float, nominals: Float[np.ndarray, " n"]) -> Steps:
    """Steps as a part of each number, or of its usual size where it is about zero."""
    return lambda z: part * np.where(np.abs(z) > 1e-6 * nominals, np.abs(z), nominals)


def _slopes(
    host: Host, steps: Steps, judge: Judge | None, points: Float[np.ndarray, "points m"]
) -> Float[np.ndarray, "..."]:
    """The derivatives of a host by its numbers, on a last axis: by four points about each, of fourth order."""
    h, (count, m) = steps(points[:, 1:]), points.shape
    moves = h[:, :, None, None] * _ABOUT[:, None] * np.eye(m)[1:, None]
    values = host((points[:, None, None] + moves).reshape(-1, m))
    values = values.reshape(count, m - 1, 4, *values.shape[1:])
    h = h.reshape(*h.shape, *(1,) * (values.ndim - 3))
    once = (values[:, :, 2] - values[:, :, 1]) / (2 * h)
    twice = (values[:, :, 3] - values[:, :, 0]) / (4 * h)
    slopes, disagreement = (np.moveaxis(part, 1, -1) for part in ((4 * once - twice) / 3, np.abs(once - twice)))
    if judge is not None:
        judge(slopes, disagreement)
    return slopes


def _by_time(host: Host, points: Float[np.ndarray, "points m"]) -> np.ndarray:
    later = np.eye(points.shape[1])[0] * _LATER
    return sum(weight * host(points + count * later) for count, weight in enumerate(_WEIGHTS)) / np.asarray(_LATER)


def differentiable(
    host: Host, shape: tuple[int, ...], steps: Steps, judge: Judge | None = None, *, exacter: Host | None = None
) -> Any:
    """A host, whose values have a shape, as a function of JAX of a time and a vector of numbers.

    `exacter`: the same with less noise, for differences.

    Derivatives of all orders exist in all modes: by the numbers to about the fourth power of a step relative to the
    scale on which the host changes; first ones are judged. Those by time cost nothing where it is not differentiated.
    Batches are evaluated together.
    """

    def batch(points: Any) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        return host(points.reshape(-1, points.shape[-1])).reshape(*points.shape[:-1], *shape)

    @jax.custom_jvp
    def function(t: Float[Array, ""], z: Float[Array, " n"]) -> Array:
        point = jnp.concatenate([t[None], z])
        return jax.pure_callback(batch, jax.ShapeDtypeStruct(shape, float), point, vmap_method="expand_dims")

    def rule(primals: Any, tangents: Any) -> Any:
        (t, z), (later, change) = primals, tangents
        value = function(t, z)
        moved = jnp.zeros_like(value)
        if not isinstance(change, SymbolicZero) and len(z):
            slopes = differentiable(partial(_slopes, exacter or host, steps, judge), (*shape, len(z)), steps)
            moved = moved + slopes(t, z) @ change
        if not isinstance(later, SymbolicZero):
            moved = moved + differentiable(partial(_by_time, host), shape, steps)(t, z) * later
        return value, moved

    function.defjvp(rule, symbolic_zeros=True)
    return lambda t, z: function(jnp.asarray(t, dtype=float), z)
