"""Joints: how a body may move relative to its parent, with the names and units of its coordinates and speeds."""

import abc
from typing import Any, ClassVar, final

import numpy as np
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.mechanics._spatial import all_known, as_array, is_known, library

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class AbstractJoint(Module):
    """The connection of a body to its parent. What a joint does is in `_trees.py`, for all bodies together.

    `coordinates` and `speeds` are suffixes: appended to the body's name, they name its coordinates and speeds. `units`
    are those of the first coordinates (quaternions, which have none, are last), `speed_units` of all speeds.
    """

    coordinates: ClassVar[tuple[str, ...]]
    speeds: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]
    speed_units: ClassVar[tuple[str, ...]]

    @abc.abstractmethod
    def refuse_impossible(self) -> None:
        """Raise `ProblemError` for known numbers that no joint has."""


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
    damping: Any = 0
    stiffness: Any = 0
    rest: Any = 0
    # Whole numbers stay known where a joint's numbers are traced.
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
        return axis / library(axis).sqrt(axis @ axis)

    @override
    def refuse_impossible(self) -> None:
        """Raise `ProblemError` for a negative damping or armature."""
        for part, why in (("damping", " A negative one would drive the joint."), ("armature", "")):
            value = getattr(self, part)
            if is_known(value) and np.any(np.asarray(value) < 0):
                kind = f"{type(self).__name__}: expected {'an' if part == 'armature' else 'a'} {part}"
                raise ProblemError(f"{kind} that is not negative; received {value}.{why}")


@final
class Revolute(AbstractAxial):
    """A hinge: the body rotates about an axis through its origin, by one angle in rad. See `AbstractAxial`."""

    units: ClassVar[tuple[str, ...]] = ("rad",)
    speed_units: ClassVar[tuple[str, ...]] = ("rad/s",)


@final
class Prismatic(AbstractAxial):
    """A slider: the body moves along an axis, by one length in m. See `AbstractAxial`."""

    units: ClassVar[tuple[str, ...]] = ("m",)
    speed_units: ClassVar[tuple[str, ...]] = ("m/s",)


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
    def refuse_impossible(self) -> None:
        pass


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
    def refuse_impossible(self) -> None:
        pass


@final
class Fixed(Module):
    """The body is rigidly fixed to its parent: no coordinates, no speeds, and no additional cost."""
