"""Spatial algebra of rigid bodies: rotations, twists, wrenches and inertias, as pairs of 3-vectors instead of
6-vectors.

Twists and wrenches are taken at the origin of a frame and in its axes. Each part is a vector, or a matrix with several
as its columns; `None` stands for a part that is always zero and costs nothing. Values known when a function is traced
stay in NumPy, so that they are computed once and not at every point.
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
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

Block: TypeAlias = Any
"""A vector (3,), a matrix of columns (3, n), or `None` for zero; a NumPy array where known, else a JAX array."""


class Pose(NamedTuple):
    """The pose of a frame in an outer one: `rotation` (3, 3) from its axes to the outer axes, `position` (3,) in m."""

    rotation: Block
    position: Block


class Twist(NamedTuple):
    """A motion: angular velocity (rad/s) and linear velocity of the frame's origin (m/s), or their derivatives."""

    angular: Block
    linear: Block


class Wrench(NamedTuple):
    """A load: moment about the frame's origin, N·m, and force, N."""

    moment: Block
    force: Block


class Inertia(NamedTuple):
    """A rigid body: mass (kg), first moment `m c` (kg·m) and second moments (3, 3) about the origin (kg·m²)."""

    mass: Any
    first: Block
    second: Block


class Articulated(NamedTuple):
    """The apparent inertia of a body whose descendants can move: blocks of `[[A, B], [Bᵀ, M]]`, each (3, 3)."""

    angular: Block
    mixed: Block
    linear: Block


def library(*values: Any) -> Any:
    """NumPy if all values are known, else JAX."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


def _either(function: Callable[..., Block], *blocks: Block) -> Block:
    """A function of many small operations, in NumPy where all arguments are known; else traced once for all its uses.

    Tracing its operations again at every use would take longer than the rest of a model.
    """
    return _jitted(function)(*blocks) if library(*blocks) is jnp else function(*blocks)


@functools.lru_cache(maxsize=16)
def _jitted(function: Callable[..., Block]) -> Callable[..., Block]:
    return jax.jit(function)


def is_known(value: Any) -> bool:
    """Whether values can be inspected. (By NumPy: within a trace, JAX would trace whatever it computes of them.)"""
    return not isinstance(value, Tracer)


def as_array(given: Any, what: str, *shapes: tuple[int, ...]) -> Block:
    """Numbers, or nested sequences of numbers and tracers, as one array.

    Raises `ProblemError` if its shape is not one of `shapes`, or if a known number is not finite.
    """
    try:
        array = _stacked(given)
    except (TypeError, ValueError) as error:
        raise refusal(what, f"numbers of shape {_any_of(shapes)}", given) from error
    if array.shape not in shapes:
        raise ProblemError(f"{what}: expected numbers of shape {_any_of(shapes)}; received shape {array.shape}.")
    if is_known(array) and not np.isfinite(np.asarray(array)).all():
        raise ProblemError(f"{what}: expected finite numbers; received {given!r}.")
    return array


def all_known(*given: Any) -> bool:
    """Whether the given values contain no distribution, decision or tracer, so that they can be checked at once."""
    leaves = jax.tree.leaves(given, is_leaf=is_leaf)
    return not any(isinstance(one, jax.Array) or is_leaf(one) for one in leaves)


def _stacked(given: Any) -> Block:
    if isinstance(given, tuple | list):
        parts = [_stacked(one) for one in given]
        return library(*parts).stack(parts)
    return jnp.asarray(given, dtype=float) if isinstance(given, Tracer) else real_array("", given)


def _any_of(shapes: tuple[tuple[int, ...], ...]) -> str:
    return " or ".join(map(str, shapes))


def plus(*terms: Block) -> Block:
    """The sum of the terms that are not `None`."""
    total = None
    for term in terms:
        total = term if total is None else total if term is None else total + term
    return total


def minus(block: Block) -> Block:
    """The negative of a block."""
    return None if block is None else -block


def times(matrix: Block, block: Block) -> Block:
    """The product of a matrix and a block; the block itself where the matrix is known to be one."""
    if matrix is None or block is None:
        return None
    return block if library(matrix) is np and np.array_equal(matrix, np.eye(3)) else matrix @ block


def cross(a: Block, b: Block) -> Block:
    """`a × b` of a vector and a vector, or column by column; `None` where one of them is known to be zero."""
    if a is None or b is None or _is_zero(a) or _is_zero(b):
        return None
    if b.ndim == 2 or library(a) is np:
        return times(skew(a), b)
    return times(skew(b).T, a) if library(b) is np else _either(_cross, a, b)


def _cross(a: Block, b: Block) -> Block:
    # Few equations on whole vectors take a compiler less time than many on their numbers.
    return _following(a * _following(b) - _following(a) * b)


def _following(a: Block) -> Block:
    """The numbers of a vector in the order y, z, x."""
    return library(a).concatenate([a[1:], a[:1]])


def _is_zero(block: Block) -> bool:
    return library(block) is np and not np.any(block)


def dot(a: Block, b: Block) -> Block:
    """`aᵀ b`, zero if either is."""
    if a is None or b is None:
        return None
    return a.T @ b


def skew(a: Block) -> Block:
    """The matrix whose product with `b` is `a × b`."""
    return _either(_skew, a)


def _skew(a: Block) -> Block:
    x, y, z = a
    zero = 0 * x
    xp = library(a)
    return xp.stack([xp.stack([zero, -z, y]), xp.stack([z, zero, -x]), xp.stack([-y, x, zero])])


def about(axis: Block, angle: Any, before: Block) -> Float[Numbers, "3 3"]:
    """`before` times the rotation by an angle about a unit axis (Rodrigues).

    The products with the axis are computed beforehand, so that a rotation needs no matrix product.
    """
    across = before @ skew(axis)
    return _either(_turned, angle, before, across, across @ skew(axis))


def _turned(angle: Any, before: Block, across: Block, twice: Block) -> Float[Numbers, "3 3"]:
    xp = library(angle)
    return before + xp.sin(angle) * across + (1 - xp.cos(angle)) * twice


def from_angles(angles: Block) -> Block:
    """The rotation of roll, pitch and yaw: about x, then y, then z of the outer frame."""
    xp = library(angles)
    (sr, sp, sy), (cr, cp, cy) = xp.sin(angles), xp.cos(angles)
    return xp.stack(
        [
            xp.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]),
            xp.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]),
            xp.stack([-sp, cp * sr, cp * cr]),
        ]
    )


def from_quaternion(quaternion: Float[Array, " 4"]) -> Float[Array, "3 3"]:
    """The rotation of a quaternion `(w, x, y, z)`, which is normalised first."""
    w, x, y, z = unit(quaternion)
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def quaternion_rates(quaternion: Float[Array, " 4"]) -> Float[Array, "4 3"]:
    """The matrix from the angular velocity in the body's axes to the rates of a quaternion."""
    w, x, y, z = unit(quaternion)
    rows = [[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]]
    return 0.5 * jnp.stack([jnp.stack(row) for row in rows])


def unit(vector: Block) -> Block:
    """A vector divided by its length."""
    return vector / library(vector).sqrt(vector @ vector)


def unit_quaternion(given: Float[Numbers, " 4"]) -> Float[Numbers, " 4"]:
    """A quaternion divided by its length; the identity for a zero quaternion, as where none was given."""
    return unit(library(given).where(given @ given == 0, np.array([1.0, 0.0, 0.0, 0.0]), given))


def composed(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, given in the frame of `outer`, expressed in the outermost frame."""
    return Pose(times(outer.rotation, inner.rotation), outer.position + times(outer.rotation, inner.position))


def twist_within(pose: Pose, twist: Twist) -> Twist:
    """An outer twist expressed in the frame at `pose`."""
    inward = pose.rotation.T
    at_origin = plus(twist.linear, cross(twist.angular, pose.position))
    return Twist(times(inward, twist.angular), times(inward, at_origin))


def wrench_outside(pose: Pose, wrench: Wrench) -> Wrench:
    """A wrench in the frame at `pose`, expressed in the outer frame."""
    force = times(pose.rotation, wrench.force)
    return Wrench(plus(times(pose.rotation, wrench.moment), cross(pose.position, force)), force)


def added(first: Any, *others: Any) -> Any:
    """The sum of several twists, wrenches or inertias, part by part."""
    return type(first)(*(plus(*parts) for parts in zip(first, *others, strict=True)))


def cross_motion(twist: Twist, other: Twist) -> Twist:
    """The rate of a twist `other` that is fixed in a frame moving with `twist`."""
    return Twist(
        cross(twist.angular, other.angular),
        plus(cross(twist.angular, other.linear), cross(twist.linear, other.angular)),
    )


def cross_force(twist: Twist, wrench: Wrench) -> Wrench:
    """The rate of a wrench or momentum that is fixed in a frame moving with `twist`."""
    return Wrench(
        plus(cross(twist.angular, wrench.moment), cross(twist.linear, wrench.force)),
        cross(twist.angular, wrench.force),
    )


def momentum(inertia: Inertia, twist: Twist) -> Wrench:
    """The inertia times a twist: momentum for a velocity, wrench for an acceleration."""
    along = None if twist.linear is None else inertia.mass * twist.linear
    return Wrench(
        plus(times(inertia.second, twist.angular), cross(inertia.first, twist.linear)),
        plus(along, minus(cross(inertia.first, twist.angular))),
    )


def power(twist: Twist, wrench: Wrench) -> Block:
    """The scalar product of twist and wrench; for columns, the matrix of all products."""
    return plus(dot(twist.angular, wrench.moment), dot(twist.linear, wrench.force))


def inertia_outside(pose: Pose, inertia: Inertia) -> Inertia:
    """The inertia of a body in the frame at `pose`, expressed in the outer frame."""
    if library(*pose) is np and np.array_equal(pose.rotation, np.eye(3)) and not np.any(pose.position):
        return inertia
    first = pose.rotation @ inertia.first
    across = skew(pose.position)
    # -P H' - H' P - m P P, with the moment moved to the outer origin (parallel axes).
    mixed = across @ skew(first)
    second = pose.rotation @ inertia.second @ pose.rotation.T - mixed - mixed.T - inertia.mass * (across @ across)
    return Inertia(inertia.mass, first + inertia.mass * pose.position, second)


def articulated(inertia: Inertia) -> Articulated:
    """A rigid inertia as an articulated one."""
    return Articulated(inertia.second, skew(inertia.first), inertia.mass * np.eye(3))


def load(inertia: Articulated, twist: Twist) -> Wrench:
    """An articulated inertia times a twist."""
    return Wrench(
        plus(times(inertia.angular, twist.angular), times(inertia.mixed, twist.linear)),
        plus(times(inertia.mixed.T, twist.angular), times(inertia.linear, twist.linear)),
    )


def articulated_outside(pose: Pose, inertia: Articulated) -> Articulated:
    """The articulated inertia in the frame at `pose`, expressed in the outer frame."""
    R, across = pose.rotation, skew(pose.position)
    angular, mixed, linear = (R @ block @ R.T for block in inertia)
    moved = across @ linear
    turned = across @ mixed.T
    return Articulated(angular + turned + turned.T - moved @ across, mixed + moved, linear)
