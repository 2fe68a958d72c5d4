"""Joints, and rigid bodies: their numbers, checked, and their order in a tree."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import is_number
from aleator._core.border import a_name, one_of
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, is_leaf
from aleator.mechanics._instant import at
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.mechanics._spatial import (
    Pose,
    all_known,
    as_array,
    from_angles,
    is_known,
    library,
    product,
    skew,
    stacked,
)
from aleator.trajectories import AbstractSignal

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


@final
class Fixed(Module):
    """The body is rigidly fixed to its parent: no coordinates, no speeds, and no additional cost."""


# The rounding error allowed in an inertia on the verge of the possible, relative to its largest moment.
_ROUNDING = 1e-9

# The matrix of moments xx, yy, zz, xy, xz, yz, row after row, is their product with this.
_MATRIX = np.eye(9)[[0, 4, 8, 1, 2, 5]]
_MATRIX[[3, 4, 5], [3, 6, 7]] = 1.0


@final
class Body(Module):
    """A rigid body of an `al.Multibody`, with the joint that connects it to its parent. Lengths in m, angles in rad.

    - `name`, `parent`: its own name and that of the body it is connected to; `None` for the ground;
    - `joint`: `al.joints.Revolute`, `al.joints.Prismatic`, `al.joints.Ball`, `al.joints.Free`, or `al.joints.Fixed` for
      a part rigidly fixed to its parent;
    - `position` (3,), `orientation`: the joint's frame in the parent's frame; the orientation is roll, pitch and yaw
      (about x, then y, then z of the parent), or a rotation matrix (3, 3). At zero coordinates the body's frame is the
      joint's;
    - `mass` in kg, `center` (3,): the centre of mass in the body's frame;
    - `inertia` in kg·m², about the centre of mass and along the body's axes: three principal moments, the six numbers
      xx, yy, zz, xy, xz, yz, or a matrix (3, 3). A plane model needs only one moment, such as `(0, 0, J)`.

    Each number may also be a tracer, alone or within a sequence. Known numbers are checked when the tree is built (for
    distributions, those at the ends of their support, when a problem is declared): `ProblemError` is raised for a
    negative mass, an orientation that is not a rotation, and an inertia that no body can have.
    """

    name: str = eqx.field(static=True)
    parent: str | None = eqx.field(static=True, default=None, kw_only=True)
    joint: AbstractJoint | Fixed = eqx.field(kw_only=True)
    mass: Any = eqx.field(kw_only=True)
    center: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    inertia: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    position: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    orientation: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)

    def __check_init__(self):
        a_name("Body: name", self.name)
        joints = "al.joints.Revolute('z') or al.joints.Fixed()"
        one_of(f"Body '{self.name}': joint", self.joint, (AbstractJoint, Fixed), joints)
        if self.parent is not None:
            a_name(f"Body '{self.name}': parent", self.parent)
        if all_known(self.mass, self.center, self.inertia):
            inertias([self])
        if all_known(self.position, self.orientation):
            placement(self)


def placement(body: Body) -> Pose:
    """The frame of a body's joint in its parent's frame."""
    return frame(f"Body '{body.name}'", body.position, body.orientation)


def frame(what: str, position: Any, orientation: Any) -> Pose:
    """A frame by its origin and by three angles or a rotation matrix. Raises `ProblemError` for what is none."""
    given = as_array(orientation, f"{what}: orientation", (3,), (3, 3))
    rotation = from_angles(given[:, None])[..., 0] if given.shape == (3,) else given
    if is_known(rotation) and not _turns(np.asarray(rotation)):
        raise ProblemError(f"{what}: orientation: expected a rotation matrix; received {orientation!r}.")
    return Pose(rotation, as_array(position, f"{what}: position", (3,)))


STRAIGHT = Pose(np.eye(3), np.zeros(3))
"""The frame of what it is given in."""


def behind(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, given in the frame at `outer`, in the outermost frame."""
    if all_known(outer) and np.array_equal(outer.rotation, STRAIGHT.rotation) and not np.any(outer.position):
        return inner
    return Pose(outer.rotation @ inner.rotation, outer.position + outer.rotation @ inner.position)


def _turns(matrix: np.ndarray) -> bool:
    return np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=_ROUNDING) and np.linalg.det(matrix) > 0


class Inertia(NamedTuple):
    """The inertia of bodies in their frames: mass (n,), kg, first moments (3, n), kg·m, second (3, 3, n), kg·m²."""

    mass: Any
    first: Any
    second: Any


def inertias(bodies: Sequence[Body]) -> Inertia:
    """The inertias of bodies, as columns. Raises `ProblemError` for one that no body has."""
    mass, center, moments = list[Any](), list[Any](), list[Any]()
    for body in bodies:
        mass.append(as_array(body.mass, f"Body '{body.name}': mass", ()))
        if is_known(mass[-1]) and np.asarray(mass[-1]) < 0:
            raise ProblemError(f"Body '{body.name}': expected a mass that is not negative; received {body.mass}.")
        where = f"Body '{body.name}': inertia"
        given = as_array(body.inertia, where, (3,), (6,), (3, 3))
        moments.append(given.reshape(9) if given.shape == (3, 3) else given @ _MATRIX[: len(given)])
        if is_known(given):
            _check_moments(np.asarray(moments[-1]).reshape(3, 3), where)
        center.append(as_array(body.center, f"Body '{body.name}': center", (3,)))
    masses, centers = stacked(mass, ()), stacked(center, (3,))
    across = skew(centers)
    second = stacked(moments, (9,)).reshape(3, 3, -1) - masses[None, None] * product(across, across)
    return Inertia(masses, masses[None] * centers, second)


def _check_moments(matrix: np.ndarray, where: str) -> None:
    """Refuse a matrix that is not symmetric or has principal moments that no body can have."""
    slack = _ROUNDING * np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > slack:
        raise ProblemError(f"{where}: expected a symmetric matrix; received {matrix.tolist()}.")
    smallest, middle, largest = np.linalg.eigvalsh(matrix)
    if smallest < -slack:
        raise ProblemError(f"{where}: expected principal moments that are not negative; received {smallest:.6g}.")
    if middle > slack and largest > smallest + middle + slack:
        raise ProblemError(
            f"{where}: no body has a principal moment ({largest:.6g}) beyond the sum of the other two ({smallest:.6g} "
            f"+ {middle:.6g}). For a plane model give the one moment that matters and two zeros."
        )


def sorted_bodies(bodies: Iterable[Body]) -> list[Body]:
    """The bodies, parents before children, otherwise in the given order.

    Raises `ProblemError` for names that occur twice, for unknown parents and for cycles.
    """
    waiting = list(bodies)
    _check_names(waiting)
    ready: list[Body] = []
    while waiting:
        known = {None, *(body.name for body in ready)}
        following = next((body for body in waiting if body.parent in known), None)
        if following is None:
            names = [body.name for body in waiting]
            raise ProblemError(f"bodies() must return a tree rooted at the ground; {names} form a cycle.")
        waiting.remove(following)
        ready.append(following)
    return ready


def _check_names(bodies: Sequence[Body]) -> None:
    names = [body.name for body in bodies]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ProblemError(f"bodies() needs one name for each body; {twice} occur twice.")
    unknown = sorted({body.parent for body in bodies if body.parent is not None} - set(names))
    if unknown:
        raise ProblemError(f"bodies() names the parents {unknown}, which are no bodies; expected some of {names}.")


Model = TypeVar("Model", bound=AbstractMechanical)
Part = TypeVar("Part")


def with_numbers(model: Model) -> Model:
    """The model with numbers in the place of distributions, decisions and signals."""
    plain = jax.tree.map(_as_number, model, is_leaf=_is_no_number)
    return plain if model._when is not None else at(plain, np.zeros(()), None)


def without_numbers(part: Part) -> Part:
    """The structure of a joint or a closure: it outlives the trace in which its numbers may have been made."""
    return jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)) if is_number(leaf) else leaf, part)


def _is_no_number(node: Any) -> bool:
    return is_leaf(node) or isinstance(node, AbstractSignal)


def _as_number(leaf: Any) -> Any:
    """A placeholder number of the right shape for a distribution, a decision or a signal."""
    if isinstance(leaf, AbstractSignal):
        plain = jax.tree.map(_as_number, leaf, is_leaf=is_leaf)
        # JAX looks a function up, which fails for a module with some fields.
        return np.ones(jax.eval_shape(lambda t: plain(t), jax.ShapeDtypeStruct((), float)).shape)
    return np.ones(leaf.shape) if is_leaf(leaf) else leaf


def refuse_moving_places(kind: str, bodies: Callable[[Array], Sequence[Body]]) -> None:
    """Raise `ProblemError` if the place or the axis of a body's joint depends on the time in `bodies(time)`.

    The recursions would miss the velocity that this causes. The dependence is read off the traced equations, not off
    values.
    """
    names: list[str] = []

    def places(s: Array) -> list[Any]:
        every = list(bodies(s))
        names[:] = [body.name for body in every]
        axes = [body.joint.direction() if isinstance(body.joint, AbstractAxial) else 0.0 for body in every]
        return [(jnp.asarray(axis), *map(jnp.asarray, placement(body))) for axis, body in zip(axes, every, strict=True)]

    closed = jax.make_jaxpr(places)(jnp.zeros(()))
    moved = set(closed.jaxpr.invars)
    for equation in closed.jaxpr.eqns:
        if any(not isinstance(one, Literal) and one in moved for one in equation.invars):
            moved.update(equation.outvars)
    for i, variable in enumerate(closed.jaxpr.outvars):
        if not isinstance(variable, Literal) and variable in moved:
            raise ProblemError(
                f"{kind}.bodies: the place or the axis of '{names[i // 3]}' depends on time: only masses and inertias "
                "may do so. Put a joint there, and prescribe its motion in al.HybridDynamics."
            )
