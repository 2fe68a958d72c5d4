"""Beside the joints of a tree: `Closure`, a joint that closes a loop, and `BodyLoad`, an external load on a body."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array, Float

from aleator._core.border import a_name, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, is_leaf
from aleator.mechanics._bodies import Body, behind, frame, placement
from aleator.mechanics._joints import AbstractAxial, Ball, Fixed, Prismatic, Revolute
from aleator.mechanics._spatial import (
    GROUND,
    Pose,
    Screws,
    all_known,
    as_array,
    columns,
    cross,
    library,
    skew,
    times,
)
from aleator.mechanics._tree_dynamics import Posture, along_screws, jacobian_at, posture_of
from aleator.mechanics._trees import Tree

Closing: TypeAlias = Revolute | Prismatic | Ball | Fixed
"""The joints that may close a loop."""
_AXES = "xyz"

# What turns (first, second) to (second, -first).
_QUARTER = np.array([[0.0, 1.0], [-1.0, 0.0]])


@final
class Closure(Module):
    """A joint between two bodies of an `al.Multibody` that have joints of their own already: it closes a loop.

    - `name`: that of the closure, which its constraints and their multipliers are called by; `parent`, `child`: the
      bodies that it binds, `None` for the ground;
    - `joint`: what it leaves free. `al.joints.Ball()` binds the point: 3 equations, `<name>_x`, `_y`, `_z`;
      `al.joints.Revolute(axis)` the point and the direction of the axis: 5; `al.joints.Prismatic(axis)` all but the way
      along the axis: 5; `al.joints.Fixed()` all: 6;
    - `position` (3,), `orientation`: the joint's frame in the parent's frame, as in `al.Body`; `child_position`,
      `child_orientation`: the same frame in the child's;
    - `planar`: whether the loop moves in the plane across the axis of `al.joints.Revolute`, where the other equations
      would say nothing new: 2, the point in this plane.

    The equations are the parent's frame minus the child's, in the axes of the parent's, m, and the angles (small, or
    zero) between them: so that multipliers are the force, N, and the moment, N·m, by which the parent acts on the
    child. Each number may be uncertain, decided or a signal.

    Raises `ProblemError` for other joints, and for springs and dampers, which belong to joints with coordinates.
    """

    name: str = eqx.field(static=True)
    parent: str | None = eqx.field(static=True, kw_only=True)
    child: str | None = eqx.field(static=True, kw_only=True)
    joint: Closing = eqx.field(kw_only=True)
    position: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    child_position: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    orientation: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    child_orientation: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    planar: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        a_name("Closure: name", self.name)
        for end in ("parent", "child"):
            if getattr(self, end) is not None:
                a_name(f"Closure '{self.name}': {end}", getattr(self, end))
        if self.parent == self.child:
            raise ProblemError(f"Closure '{self.name}': expected two bodies; received '{self.parent}' twice.")
        if not isinstance(self.joint, Closing):
            raise refusal(
                f"Closure '{self.name}': joint", "al.joints.Revolute('z'), Prismatic, Ball or Fixed", self.joint
            )
        if self.planar and not isinstance(self.joint, Revolute):
            raise ProblemError(
                f"Closure '{self.name}': expected planar=True with al.joints.Revolute, whose axis stands on the plane; "
                f"received {type(self.joint).__name__}."
            )
        if isinstance(self.joint, AbstractAxial) and not _is_passive(self.joint):
            raise ProblemError(
                f"Closure '{self.name}': expected a joint without spring and damper (and armature), since it has no "
                "coordinate; received one with them. Close the loop at another joint, or add their force by load(q, v)."
            )
        for given in ((self.position, self.orientation), (self.child_position, self.child_orientation)):
            if all_known(*given):
                frame(f"Closure '{self.name}'", *given)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its equations."""
        return tuple(f"{self.name}_{end}" for end in (*self._point_ends(), *self._turn_ends()))

    @property
    def units(self) -> tuple[str, ...]:
        """The units of its multipliers."""
        return ("N",) * len(self._point_ends()) + ("N·m",) * len(self._turn_ends())

    def residual(self, poses: Mapping[str, Pose]) -> Float[Array, " equations"]:
        """What is left of its equations, from the poses of the bodies in the world."""
        outer, inner = self._frames(poses)
        apart = outer.rotation.T @ (outer.position - inner.position)
        return jnp.concatenate([self._point(apart), self._turn(outer.rotation.T @ inner.rotation)])

    def jacobian(self, tree: Tree, posture: Posture, poses: Mapping[str, Pose]) -> Float[Array, "equations speeds"]:
        """How they change with the speeds: exact wherever the bodies are."""
        rows = [GROUND if end is None else tree.places[end][0] for end in (self.parent, self.child)]
        outer, inner = self._frames(poses)
        # Of the parent's frame against the child's, where that is.
        parent, child = (jacobian_at(tree, posture, row, inner.position) for row in rows)
        angular, linear = (outer.rotation.T @ (first - second) for first, second in zip(parent, child, strict=True))
        turning = self._turning(outer.rotation.T @ inner.rotation, angular)
        return jnp.concatenate([self._point(linear), turning])

    def _frames(self, poses: Mapping[str, Pose]) -> tuple[Pose, Pose]:
        """The frames in the world that it brings together: on the parent and on the child."""
        outer = frame(f"Closure '{self.name}'", self.position, self.orientation)
        inner = frame(f"Closure '{self.name}'", self.child_position, self.child_orientation)
        return (
            outer if self.parent is None else behind(poses[self.parent], outer),
            inner if self.child is None else behind(poses[self.child], inner),
        )

    def _point(self, apart: Any) -> Any:
        if isinstance(self.joint, Prismatic) or self.planar:
            return _across(self.joint.direction()) @ apart  # type: ignore[union-attr]
        return apart

    def _turn(self, turned: Any) -> Any:
        if self.planar or isinstance(self.joint, Ball):
            return np.zeros(0)
        if isinstance(self.joint, Revolute):
            axis = self.joint.direction()
            return _QUARTER @ _across(axis) @ turned @ axis
        skewed = 0.5 * (turned.T - turned)
        return library(turned).stack([skewed[2, 1], skewed[0, 2], skewed[1, 0]])

    def _turning(self, turned: Any, motion: Any) -> Any:
        """How `_turn` changes with speeds: `motion` (3, speeds) is the parent's angular velocity against the child's.

        The child's frame then turns against the parent's as `Ṙ = -[ω] R`, and `Rᵀ [ω] + [ω] R = [(tr R - R) ω]`.
        """
        if self.planar or isinstance(self.joint, Ball):
            return np.zeros((0, motion.shape[1]))
        if isinstance(self.joint, Revolute):
            axis = self.joint.direction()
            return _QUARTER @ _across(axis) @ skew((turned @ axis)[:, None])[..., 0] @ motion
        return 0.5 * (jnp.trace(turned) * motion - turned @ motion)

    def _point_ends(self) -> tuple[str, ...]:
        return _ends(self.joint) if isinstance(self.joint, Prismatic) or self.planar else tuple(_AXES)

    def _turn_ends(self) -> tuple[str, ...]:
        if self.planar or isinstance(self.joint, Ball):
            return ()
        ends = _ends(self.joint) if isinstance(self.joint, Revolute) else tuple(_AXES)
        return tuple(f"turn_{end}" for end in ends)


@final
class Coupling(Module):
    """A coordinate of an `al.Multibody` that is a polynomial of another one: gears, mimic joints. `name` is its own.

    `follower - rest = coefficients[0] + coefficients[1] (leader - leader_rest) + ...`, up to the fourth power; without
    a leader (`None`) the follower stays where it is. All in the units of the coordinates, rad or m.

    Raises `ProblemError` for what are no names, and for other than five coefficients.
    """

    name: str = eqx.field(static=True)
    follower: str = eqx.field(static=True, kw_only=True)
    leader: str | None = eqx.field(static=True, kw_only=True)
    coefficients: Any = eqx.field(default=(0.0, 1.0, 0.0, 0.0, 0.0), kw_only=True)
    rest: Any = eqx.field(default=0.0, kw_only=True)
    leader_rest: Any = eqx.field(default=0.0, kw_only=True)

    units: ClassVar[tuple[str, ...]] = ()

    def __check_init__(self):
        a_name("Coupling: name", self.name)
        where = f"Coupling '{self.name}'"
        a_name(f"{where}: follower", self.follower)
        if self.leader is not None:
            a_name(f"{where}: leader", self.leader)
        for part, shape in (("coefficients", (5,)), ("rest", ()), ("leader_rest", ())):
            if all_known(value := getattr(self, part)):
                as_array(value, f"{where}: {part}", shape)

    @property
    def names(self) -> tuple[str, ...]:
        """The name of its equation."""
        return (self.name,)

    def residual(self, at: Mapping[str, Any]) -> Float[Array, ""]:
        """What is left of the equation, for coordinates by name."""
        if missing := [one for one in (self.follower, self.leader) if one is not None and one not in at]:
            raise ProblemError(
                f"Coupling '{self.name}': there is no coordinate {missing}; expected some of {list(at)}."
            )
        away = 0.0 if self.leader is None else at[self.leader] - self.leader_rest
        return at[self.follower] - self.rest - jnp.polyval(jnp.flip(jnp.asarray(self.coefficients)), jnp.asarray(away))


def checked_closures(kind: str, given: Any) -> Sequence[Closure | Coupling]:
    """What a user's `closures` gives. Raises `ProblemError` for what is none."""
    if not isinstance(given, tuple | list) or not all(isinstance(one, Closure | Coupling) for one in given):
        raise ProblemError(f"{kind}.closures returns a tuple of al.joints.Closure; received {given!r}.")
    return given


def bodies_bound(kind: str, closures: Sequence[Closure], tree: Tree) -> set[str]:
    """The names of the bodies that closures bind. Raises `ProblemError` for what is no body."""
    bound = {(closure.name, end) for closure in closures for end in (closure.parent, closure.child) if end is not None}
    for name, end in sorted(bound):
        if end not in tree.places:
            raise ProblemError(
                f"{kind}.closures: '{name}' binds '{end}', which is no body; expected some of "
                f"{sorted(tree.places)}, or None for the ground."
            )
    return {end for _, end in bound}


def _is_passive(joint: AbstractAxial) -> bool:
    given = joint.damping, joint.stiffness, joint.armature
    return not any(is_leaf(one) or not isinstance(one, int | float) or one != 0 for one in given)


def _ends(joint: Any) -> tuple[str, ...]:
    """The names of the two directions across an axis."""
    if not isinstance(joint.axis, str):
        return ("first", "second")
    along = _AXES.index(joint.axis)
    return _AXES[(along + 1) % 3], _AXES[(along + 2) % 3]


def _across(axis: Any) -> Any:
    """Two unit vectors as rows that stand on a unit vector and on one another, all three right-handed."""
    xp = library(axis)
    # The axis of coordinates after the nearest one: y for x, so that the directions across z are x and y.
    following = xp.roll(xp.eye(3)[xp.argmax(xp.abs(axis))], 1)
    first = following - (following @ axis) * axis
    first = first / xp.sqrt(first @ first)
    return xp.stack([first, xp.cross(axis, first)])


@final
class BodyLoad(Module):
    """An external force and moment on one body of an `al.Multibody`: wind, contact, thrust.

    - `body`: its name; `at` (3,): where the force acts, in the body's frame, m; by default its origin;
    - `force` (3,), N, and `moment` (3,), N·m: in the world's axes. A force that rotates with its body is
      `self.poses(q)["rocket"].rotation @ jnp.array([0.0, 0.0, thrust])`.

    Raises `ProblemError` for other shapes and for non-finite numbers.
    """

    body: str = eqx.field(static=True)
    force: Any = (0.0, 0.0, 0.0)
    moment: Any = (0.0, 0.0, 0.0)
    at: Any = (0.0, 0.0, 0.0)

    def __check_init__(self):
        a_name("BodyLoad: body", self.body)
        for part in ("force", "moment", "at"):
            as_array(getattr(self, part), f"BodyLoad on '{self.body}', {part}", (3,))


def generalised(kind: str, tree: Tree, q: Float[Array, " coordinates"], loads: Any) -> Float[Array, " speeds"]:
    """The generalised force of the loads. Those on bodies fixed to the ground drop out.

    Raises `ProblemError` for anything but a load, and for an unknown body.
    """
    if not isinstance(loads, tuple | list) or not all(isinstance(load, BodyLoad) for load in loads):
        raise ProblemError(f"{kind}.body_loads returns a tuple of al.BodyLoad; received {loads!r}.")
    for load in loads:
        if load.body not in tree.places:
            raise ProblemError(
                f"{kind}.body_loads: there is no body '{load.body}'; expected one of {sorted(tree.places)}."
            )
    loads = [load for load in loads if tree.places[load.body][0] != GROUND]
    if not loads:
        return jnp.zeros(tree.axes.shape[1])
    at: list[Any] = []
    for load in loads:
        within, local = tree.places[load.body][1], as_array(load.at, "at", (3,))
        at.append(local if within is None else within.position + within.rotation @ local)
    posture, rows = posture_of(tree, q), [tree.places[load.body][0] for load in loads]
    force, moment = (
        jnp.stack([as_array(getattr(load, part), part, (3,)) for load in loads], axis=1) for part in ("force", "moment")
    )
    arms = columns(posture.arms, rows) + times(columns(posture.poses.rotation, rows), jnp.stack(at, axis=1))
    return along_screws(posture.screws, tree.carries[:, rows], Screws(moment + cross(arms, force), force))


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
