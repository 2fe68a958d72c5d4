"""Joints: how a body may move relative to its parent, with its coordinates and speeds."""

import abc
from typing import Any, ClassVar, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.mechanics._spatial import (
    Block,
    Numbers,
    Pose,
    Twist,
    about,
    all_known,
    as_array,
    from_quaternion,
    is_known,
    library,
    quaternion_rates,
    unit,
    unit_quaternion,
)

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class AbstractJoint(Module):
    """The connection of a body to its parent: coordinates `q`, speeds `v`, and the motion that they describe.

    `coordinates` and `speeds` are suffixes: appended to the body's name, they name its coordinates and speeds. `units`
    are those of the first coordinates (quaternions, which have none, are last), `speed_units` of all speeds.
    """

    coordinates: ClassVar[tuple[str, ...]]
    speeds: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]
    speed_units: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def pose(self, placement: Pose, q: Float[Numbers, " coordinates"]) -> Pose:
        """The body in its parent's frame; `placement` is the joint's own frame there."""

    @abc.abstractmethod
    def subspace(self, q: Float[Numbers, " coordinates"]) -> Twist:
        """`S(q)`: the body's twist relative to its parent, in the body's axes, one column per speed."""

    def twist(self, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"]) -> Twist:
        """`S(q) v`."""
        return Twist(*(None if block is None else block @ v for block in self.subspace(q)))

    def drift(self, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"]) -> Twist:
        """`Ṡ(q) v`, in the body's axes."""
        del q, v
        return Twist(None, None)

    def passive(self, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"]) -> Float[Numbers, " speeds"]:
        """The force of springs and dampers along each speed, N or N·m."""
        del q
        return library(v).zeros_like(v)

    def rotors(self) -> Block:
        """The inertia along each speed of what turns with the joint alone, (speeds, speeds); `None` for none."""
        return None

    def energy(self, q: Float[Numbers, " coordinates"]) -> Float[Array, ""]:
        """The energy in springs, J."""
        del q
        return jnp.zeros(())

    @abc.abstractmethod
    def velocity_map(self, q: Float[Numbers, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        """`H(q)`, from speeds to the rates of the coordinates."""

    def normalised(self, q: Float[Numbers, " coordinates"]) -> Float[Numbers, " coordinates"]:
        """The coordinates, with quaternions normalised; a zero quaternion becomes the identity."""
        return q


class AbstractAxial(AbstractJoint):
    """A joint along or about one axis, with a spring, a damper and the rotor of a geared motor: force `-damping rate -
    stiffness (q - rest) - armature acceleration`.

    - `axis`: "x", "y", "z", or a nonzero vector of any length, in the joint's frame (which is also the body's);
    - `damping`: N·m·s/rad, or N·s/m, not negative; `stiffness`: N·m/rad, or N/m; `rest`: the coordinate at which the
      spring is free of force, rad or m;
    - `armature`: the rotor's inertia times the square of the gear ratio, kg·m², or kg; not negative. As usual, its
      gyroscopic moments are neglected.
    """

    axis: Any
    damping: Any = 0.0
    stiffness: Any = 0.0
    rest: Any = 0.0
    # A whole number, which stays known where a joint's numbers are traced.
    armature: Any = 0

    coordinates: ClassVar[tuple[str, ...]] = ("",)
    speeds: ClassVar[tuple[str, ...]] = ("_rate",)

    def __check_init__(self):
        if all_known(self.axis):
            self.direction()
        for part in ("damping", "stiffness", "rest", "armature"):
            if all_known(value := getattr(self, part)):
                as_array(value, f"{type(self).__name__}: {part}", ())

    def direction(self) -> Any:
        """The axis as a unit vector. Raises `ProblemError` for anything but an axis."""
        name = type(self).__name__
        if isinstance(self.axis, str) and self.axis not in _AXES:
            raise ProblemError(f"{name}: expected the axis 'x', 'y' or 'z', or a vector; received '{self.axis}'.")
        axis = as_array(_AXES[self.axis] if isinstance(self.axis, str) else self.axis, f"{name}: axis", (3,))
        if is_known(axis) and not 0 < np.linalg.norm(np.asarray(axis)) < np.inf:
            raise ProblemError(f"{name}: expected an axis of finite, nonzero length; received {self.axis}.")
        return unit(axis)

    @override
    def passive(self, q: Float[Numbers, " 1"], v: Float[Numbers, " 1"]) -> Float[Numbers, " 1"]:
        """Raises `ProblemError` for a negative damping."""
        self._refuse_negative("a damping", self.damping, " A negative one would drive the joint.")
        return -self.damping * v - self.stiffness * (q - self.rest)

    @override
    def rotors(self) -> Block:
        """Raises `ProblemError` for a negative armature."""
        self._refuse_negative("an armature", self.armature)
        return None if is_known(self.armature) and not np.any(self.armature) else self.armature * np.eye(1)

    @override
    def energy(self, q: Float[Numbers, " 1"]) -> Float[Array, ""]:
        return 0.5 * self.stiffness * (q[0] - self.rest) ** 2

    def velocity_map(self, q: Float[Numbers, " 1"]) -> Float[Array, "1 1"]:
        """One."""
        del q
        return jnp.ones((1, 1))

    def _refuse_negative(self, part: str, value: Any, why: str = "") -> None:
        if is_known(value) and np.any(np.asarray(value) < 0):
            raise ProblemError(f"{type(self).__name__}: expected {part} that is not negative; received {value}.{why}")


@final
class Revolute(AbstractAxial):
    """A hinge: the body rotates about an axis through its origin, by one angle in rad. See `AbstractAxial`."""

    units: ClassVar[tuple[str, ...]] = ("rad",)
    speed_units: ClassVar[tuple[str, ...]] = ("rad/s",)

    @override
    def pose(self, placement: Pose, q: Float[Numbers, " 1"]) -> Pose:
        return Pose(about(self.direction(), q[0], placement.rotation), placement.position)

    @override
    def subspace(self, q: Float[Numbers, " 1"]) -> Twist:
        del q
        return Twist(self.direction()[:, None], None)

    @override
    def twist(self, q: Float[Numbers, " 1"], v: Float[Numbers, " 1"]) -> Twist:
        del q
        return Twist(self.direction() * v[0], None)


@final
class Prismatic(AbstractAxial):
    """A slider: the body moves along an axis, by one length in m. See `AbstractAxial`."""

    units: ClassVar[tuple[str, ...]] = ("m",)
    speed_units: ClassVar[tuple[str, ...]] = ("m/s",)

    @override
    def pose(self, placement: Pose, q: Float[Numbers, " 1"]) -> Pose:
        along = placement.rotation @ self.direction()
        return Pose(placement.rotation, placement.position + along * q[0])

    @override
    def subspace(self, q: Float[Numbers, " 1"]) -> Twist:
        del q
        return Twist(None, self.direction()[:, None])

    @override
    def twist(self, q: Float[Numbers, " 1"], v: Float[Numbers, " 1"]) -> Twist:
        del q
        return Twist(None, self.direction() * v[0])


@final
class Ball(AbstractJoint):
    """The body rotates about a point. Coordinates: a unit quaternion `(w, x, y, z)`, from the joint's axes to the
    body's; speeds: the angular velocity relative to the parent, in the body's axes, rad/s. Components missing from a
    start are those of the identity, `(1, 0, 0, 0)`.
    """

    coordinates: ClassVar[tuple[str, ...]] = ("_w", "_x", "_y", "_z")
    speeds: ClassVar[tuple[str, ...]] = ("_omega_x", "_omega_y", "_omega_z")
    units: ClassVar[tuple[str, ...]] = ()
    speed_units: ClassVar[tuple[str, ...]] = ("rad/s",) * 3

    @override
    def pose(self, placement: Pose, q: Float[Numbers, " 4"]) -> Pose:
        return Pose(placement.rotation @ from_quaternion(q), placement.position)

    @override
    def subspace(self, q: Float[Numbers, " 4"]) -> Twist:
        del q
        return Twist(np.eye(3), None)

    @override
    def twist(self, q: Float[Numbers, " 4"], v: Float[Numbers, " 3"]) -> Twist:
        del q
        return Twist(v, None)

    @override
    def velocity_map(self, q: Float[Numbers, " 4"]) -> Float[Array, "4 3"]:
        return quaternion_rates(q)

    @override
    def normalised(self, q: Float[Numbers, " 4"]) -> Float[Numbers, " 4"]:
        return unit_quaternion(q)


@final
class Free(AbstractJoint):
    """The body moves freely. Coordinates: the position of its origin in the joint's frame, m, then a unit quaternion
    `(w, x, y, z)`; speeds: the rates of that position, in the joint's axes (those of the parent, unless `orientation`
    rotates them), m/s, then the angular velocity relative to the parent, in the body's axes, rad/s.
    """

    coordinates: ClassVar[tuple[str, ...]] = ("_x", "_y", "_z", "_qw", "_qx", "_qy", "_qz")
    speeds: ClassVar[tuple[str, ...]] = ("_x_rate", "_y_rate", "_z_rate", "_omega_x", "_omega_y", "_omega_z")
    units: ClassVar[tuple[str, ...]] = ("m",) * 3
    speed_units: ClassVar[tuple[str, ...]] = ("m/s",) * 3 + ("rad/s",) * 3

    @override
    def pose(self, placement: Pose, q: Float[Numbers, " 7"]) -> Pose:
        rotation = placement.rotation @ from_quaternion(q[3:])
        return Pose(rotation, placement.position + placement.rotation @ q[:3])

    @override
    def subspace(self, q: Float[Numbers, " 7"]) -> Twist:
        zero = np.zeros((3, 3))
        return Twist(np.hstack([zero, np.eye(3)]), jnp.hstack([from_quaternion(q[3:]).T, zero]))

    @override
    def twist(self, q: Float[Numbers, " 7"], v: Float[Numbers, " 6"]) -> Twist:
        return Twist(v[3:], from_quaternion(q[3:]).T @ v[:3])

    @override
    def drift(self, q: Float[Numbers, " 7"], v: Float[Numbers, " 6"]) -> Twist:
        return Twist(None, -jnp.cross(v[3:], from_quaternion(q[3:]).T @ v[:3]))

    @override
    def velocity_map(self, q: Float[Numbers, " 7"]) -> Float[Array, "7 6"]:
        return jnp.zeros((7, 6)).at[:3, :3].set(jnp.eye(3)).at[3:, 3:].set(quaternion_rates(q[3:]))

    @override
    def normalised(self, q: Float[Numbers, " 7"]) -> Float[Numbers, " 7"]:
        return library(q).concatenate([q[:3], unit_quaternion(q[3:])])


@final
class Fixed(Module):
    """The body is rigidly fixed to its parent: no coordinates, no speeds, and no additional cost."""
