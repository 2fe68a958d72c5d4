"""Rotations and vectors of many bodies at once: arrays of shapes (3, n) and (3, 3, n), with a body in each column.

Numbers known when a function is traced stay in NumPy, so that they are computed once and not at every point. Products
are sums over an axis in front of the bodies, which a compiler fuses: as matrix products they compile five times as
long, and without optimisation run five times as long.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.border import real_array, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf

if TYPE_CHECKING:
    Numbers: TypeAlias = Array
else:
    # An array of NumPy where its numbers are known, which type checkers take for one of JAX.
    Numbers = Array | np.ndarray

GROUND = -1
"""What is above a column whose frame is in that of the ground."""

# The matrix of `a ×` by the places of its entries in `a`, and their signs.
_PLACES = np.array([[0, 2, 1], [2, 0, 0], [1, 0, 0]])
_SIGNS = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])[..., None]

# The rates of a quaternion `(w, x, y, z)` by its entries and the angular velocity in the body's axes.
_RATES = 0.5 * np.array(
    [
        [[0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, -1]],
        [[1, 0, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0]],
        [[0, 0, 0, 1], [1, 0, 0, 0], [0, -1, 0, 0]],
        [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0]],
    ]
)


class Pose(NamedTuple):
    """Frames in an outer one: `rotation` (3, 3, n) from their axes to the outer axes, `position` (3, n), m; or one."""

    rotation: Any
    position: Any


class Screws(NamedTuple):
    """Motions or loads about a point that moves with nothing, in the world's axes, by columns.

    Of a motion the angular velocity, rad/s, and the velocity at the point, m/s; of a load moment, N·m, and force, N.
    """

    angular: Any
    linear: Any


def library(*values: Any) -> Any:
    """NumPy if all values are known, else JAX."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


def is_known(value: Any) -> bool:
    """Whether values can be inspected. (By NumPy: within a trace, JAX would trace whatever it computes of them.)"""
    return not isinstance(value, Tracer)


def all_known(*values: Any) -> bool:
    """Whether there is no distribution, decision or tracer in values, so that they can be checked at once."""
    leaves = jax.tree.leaves(values, is_leaf=is_leaf)
    return not any(isinstance(leaf, jax.Array) or is_leaf(leaf) for leaf in leaves)


def as_array(value: Any, what: str, *shapes: tuple[int, ...]) -> Any:
    """Numbers, or nested sequences of numbers and tracers, as one array.

    Raises `ProblemError` if its shape is not one of `shapes`, or if a known number is not finite.
    """
    expected = " or ".join(map(str, shapes))
    try:
        array = _stacked(value)
    except (TypeError, ValueError) as error:
        raise refusal(what, f"numbers of shape {expected}", value) from error
    if array.shape not in shapes:
        raise ProblemError(f"{what}: expected numbers of shape {expected}; received shape {array.shape}.")
    if is_known(array) and not np.isfinite(np.asarray(array)).all():
        raise ProblemError(f"{what}: expected finite numbers; received {value!r}.")
    return array


def _stacked(value: Any) -> Any:
    if isinstance(value, tuple | list):
        parts = [_stacked(part) for part in value]
        return library(*parts).stack(parts)
    return jnp.asarray(value, dtype=float) if isinstance(value, Tracer) else real_array("", value)


def stacked(parts: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Arrays of one shape as columns: in one equation, however many there are."""
    xp = library(*parts)
    if xp is np or not shape:
        return xp.stack(parts, axis=-1) if parts else np.zeros((*shape, 0))
    return jnp.moveaxis(jnp.concatenate(parts).reshape(len(parts), *shape), 0, -1)


def columns(array: Any, places: Sequence[int]) -> Any:
    """Some columns of an array: a slice where they follow one another, else a product with known numbers."""
    if len(places) == 0 or list(places) == list(range(places[0], places[0] + len(places))):
        first = places[0] if len(places) else 0
        return array if len(places) == array.shape[-1] else array[..., first : first + len(places)]
    return array[..., list(places)] if library(array) is np else array @ np.eye(array.shape[-1])[:, list(places)]


def scattered(parts: Sequence[tuple[Sequence[int], Any]]) -> Any:
    """Arrays whose columns have the given places in one array, of which they are all columns."""
    held = [(places, array) for places, array in parts if len(places)] or parts[:1]
    if len(held) == 1 and list(held[0][0]) == sorted(held[0][0]):
        return held[0][1]
    listed = [place for places, _ in held for place in places]
    joined = library(*(array for _, array in held)).concatenate([array for _, array in held], axis=-1)
    return columns(joined, [listed.index(place) for place in range(len(listed))])


def times(matrices: Float[Numbers, "i j n"], vectors: Float[Numbers, "j n"]) -> Float[Numbers, "i n"]:
    """The products of matrices and vectors, body by body."""
    return (matrices * vectors[None]).sum(1)


def product(first: Float[Numbers, "i j n"], second: Float[Numbers, "j k n"]) -> Float[Numbers, "i k n"]:
    """The products of matrices, body by body."""
    return (first[:, :, None] * second[None]).sum(1)


def combined(tensors: Float[Numbers, "i j k n"], matrices: Float[Numbers, "j k n"]) -> Float[Numbers, "i n"]:
    """The products of tensors and matrices over both their last indices, body by body."""
    return (tensors * matrices[None]).sum((1, 2))


def skew(vectors: Float[Numbers, "3 n"]) -> Float[Numbers, "3 3 n"]:
    """The matrices whose products with `b` are `a × b`."""
    if library(vectors) is np:
        return vectors[_PLACES] * _SIGNS
    # One equation, where indexing takes five.
    numbers = lax.GatherDimensionNumbers(offset_dims=(2,), collapsed_slice_dims=(0,), start_index_map=(0,))
    entries = lax.gather(
        vectors, _PLACES[..., None], numbers, (1, vectors.shape[1]), mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS
    )
    return entries * _SIGNS


def cross(a: Float[Numbers, "3 n"], b: Float[Numbers, "3 n"]) -> Float[Numbers, "3 n"]:
    """`a × b`, body by body."""
    return times(skew(a), b)


def composed(outer: Pose, inner: Pose) -> Pose:
    """Poses `inner`, given in the frames at `outer`, in the outermost frame."""
    return Pose(product(outer.rotation, inner.rotation), outer.position + times(outer.rotation, inner.position))


def composed_upwards(local: Pose, above: Sequence[int]) -> Pose:
    """Poses in the frames of what is above each, or `GROUND`, as poses in the frame of the ground.

    By doubling: in each round with those as many columns further up as before.
    """
    poses, further = local, np.array(above, dtype=int)
    while (further != GROUND).any():
        carried = (np.arange(len(further))[:, None] == further[None]).astype(float)
        # What is on the ground is composed with the ground's own frame.
        straight = np.eye(3)[..., None] * (further == GROUND)
        poses = composed(Pose(poses.rotation @ carried + straight, poses.position @ carried), poses)
        further = np.where(further == GROUND, GROUND, further[further])
    return poses


def turned(
    before: Float[Numbers, "3 3 n"], axes: Float[Numbers, "3 n"], angles: Float[Numbers, " n"]
) -> Float[Numbers, "3 3 n"]:
    """`before` times the rotations by angles about unit axes (Rodrigues).

    The products with the axes come first, so that a rotation about known axes needs no matrix product.
    """
    xp, across = library(angles), product(before, skew(axes))
    sine, cosine = xp.sin(angles)[None, None], xp.cos(angles)[None, None]
    return before + sine * across + (1 - cosine) * product(across, skew(axes))


def from_angles(angles: Float[Numbers, "3 n"]) -> Float[Numbers, "3 3 n"]:
    """The rotations of roll, pitch and yaw: about x, then y, then z of the outer frame."""
    straight: Any = np.repeat(np.eye(3)[..., None], angles.shape[1], axis=2)
    x, y, z = (turned(straight, straight[i], angles[i]) for i in range(3))
    return product(product(z, y), x)


def from_quaternions(quaternions: Float[Numbers, "4 n"]) -> Float[Numbers, "3 3 n"]:
    """The rotations of quaternions `(w, x, y, z)`, which are normalised first: `1 + 2 w [u] + 2 [u]²`."""
    unit = normalised(quaternions)
    across = skew(unit[1:])
    straight: Any = np.eye(3)[..., None]
    return straight + 2 * (unit[None, :1] * across + product(across, across))


def quaternion_rates(quaternions: Float[Numbers, "4 n"]) -> Float[Numbers, "4 3 n"]:
    """The matrices from the angular velocity in the body's axes to the rates of quaternions."""
    return library(quaternions).tensordot(_RATES, normalised(quaternions), 1)


def normalised(vectors: Float[Numbers, "k n"]) -> Float[Numbers, "k n"]:
    """Vectors divided by their lengths."""
    return vectors / library(vectors).sqrt((vectors * vectors).sum(0))[None]


def unit_quaternions(quaternions: Float[Numbers, "4 n"]) -> Float[Numbers, "4 n"]:
    """Quaternions divided by their lengths; the identity for a zero quaternion, as where none was given."""
    identity = np.array([1.0, 0.0, 0.0, 0.0])[:, None]
    return normalised(library(quaternions).where((quaternions == 0).all(0)[None], identity, quaternions))
