"""What acts on bodies beside their joints: `Closure`, a joint that closes a loop; `Coupling`, a coordinate that follows
another one; `BodyLoad`, an external load.

Equations of closures are columns of arrays, however many there are: a direction of the parent along which two points
agree, or directions of parent and child that stay at right angles. How fast one changes is the power of a unit wrench,
which acts on parent and child with opposite signs.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import block_diagonal
from aleator._core.border import a_name, members, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, is_leaf
from aleator.mechanics._bodies import AbstractAxial, Ball, Fixed, Prismatic, Revolute, behind, frame
from aleator.mechanics._spatial import (
    GROUND,
    Numbers,
    Pose,
    Screws,
    all_known,
    as_array,
    columns,
    composed,
    cross,
    library,
    stacked,
    times,
)
from aleator.mechanics._tree_dynamics import Posture, along_screws
from aleator.mechanics._trees import Tree, side_by_side

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

    def frames(self) -> tuple[Pose, Pose]:
        """The joint's frame in that of the parent, and in that of the child."""
        what = f"Closure '{self.name}'"
        outer, inner = (self.position, self.orientation), (self.child_position, self.child_orientation)
        return frame(what, *outer), frame(what, *inner)

    def along(self) -> Any:
        """The directions (points, 3) of the parent's frame along which the origins of both frames agree."""
        if isinstance(self.joint, Prismatic) or self.planar:
            return _across(self.joint.direction())  # type: ignore[union-attr]
        return np.eye(3)

    def turned(self) -> tuple[Any, Any, Float[np.ndarray, "turns pairs"]]:
        """Directions (pairs, 3) of the parent's frame and of the child's, and the weights of their products in what is
        zero.
        """
        if self.planar or isinstance(self.joint, Ball):
            return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0))
        if isinstance(self.joint, Revolute):
            axis = self.joint.direction()
            return _QUARTER @ _across(axis), library(axis).stack([axis, axis]), np.eye(2)
        # Of a small angle: half the difference of opposite entries of the rotation matrix between both frames.
        halves = 0.5 * np.eye(3)
        return np.eye(3)[[1, 2, 0, 2, 0, 1]], np.eye(3)[[2, 0, 1, 1, 2, 0]], np.hstack([halves, -halves])

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


def couplings_apart(
    couplings: Sequence[Coupling], names: Sequence[str], q: Float[Array, " coordinates"]
) -> Float[Array, " couplings"]:
    """What is left of the equations of couplings. Raises `ProblemError` for coordinates that do not exist."""
    left = [jnp.zeros(0)]
    for coupling in couplings:
        ends = [end for end in (coupling.follower, coupling.leader) if end is not None]
        if missing := [end for end in ends if end not in names]:
            raise ProblemError(
                f"Coupling '{coupling.name}': there is no coordinate {missing}; expected some of {list(names)}."
            )
        away = 0.0 if coupling.leader is None else q[names.index(coupling.leader)] - coupling.leader_rest
        follows = jnp.polyval(jnp.flip(jnp.asarray(coupling.coefficients)), jnp.asarray(away))
        left.append((q[names.index(coupling.follower)] - coupling.rest - follows)[None])
    return jnp.concatenate(left)


class Closed(NamedTuple):
    """Closures of a tree as columns: one for each closure, for each direction, and for each pair of directions.

    - `rows`: those of the parents and of the children, and for the ground as many as there are; `frames` (closures): of
      the joints in these rows;
    - `along` (3, directions): of the parents; `turned` (3, pairs): of the parents, and of the children;
    - `owners`: the closure of each direction, pair and equation; `weights`: by which those make up these.
    """

    tree: Tree
    rows: tuple[list[int], list[int]]
    frames: tuple[Pose, Pose]
    along: Float[Numbers, "3 directions"]
    turned: tuple[Float[Numbers, "3 pairs"], Float[Numbers, "3 pairs"]]
    owners: tuple[list[int], list[int], list[int]]
    weights: tuple[Float[np.ndarray, "directions equations"], Float[np.ndarray, "pairs equations"]]

    def apart(self, posture: Posture) -> Float[Array, " equations"]:
        """What is left of the equations."""
        outer, inner, along, first, second = self._in_world(posture)
        points = columns(outer.position - inner.position, self.owners[0])
        return (along * points).sum(0) @ self.weights[0] + (first * second).sum(0) @ self.weights[1]

    def jacobian(self, posture: Posture) -> Float[Array, "equations speeds"]:
        """How they change with the speeds: exact wherever the bodies are."""
        _, inner, along, first, second = self._in_world(posture)
        force, turning = along @ self.weights[0], cross(first, second) @ self.weights[1]
        # The power of a force at the child's point is that of the force, and of its moment about the tree's origin.
        points, result = columns(inner.position, self.owners[0]), 0.0
        for rows, sign in zip(self.rows, (1.0, -1.0), strict=True):
            held = [rows[i] for i in self.owners[0]]
            arms = points - columns(_with_ground(posture.poses.position - posture.arms, 0.0), held)
            moment = cross(arms, along) @ self.weights[0] + turning
            carried = _with_ground(self.tree.carries, 0.0)[:, [rows[i] for i in self.owners[2]]]
            result = result + sign * carried.T * (moment.T @ posture.screws.angular + force.T @ posture.screws.linear)
        return jnp.asarray(result)

    def _in_world(self, posture: Posture) -> tuple[Pose, Pose, Any, Any, Any]:
        """The frames of the parents and of the children, and their directions."""
        bodies = Pose(_with_ground(posture.poses.rotation, np.eye(3)), _with_ground(posture.poses.position, 0.0))
        outer, inner = (
            composed(Pose(*(columns(part, rows) for part in bodies)), frames)
            for rows, frames in zip(self.rows, self.frames, strict=True)
        )
        points, pairs, _ = self.owners
        along = times(columns(outer.rotation, points), self.along)
        first = times(columns(outer.rotation, pairs), self.turned[0])
        return outer, inner, along, first, times(columns(inner.rotation, pairs), self.turned[1])


def closed(kind: str, closures: Sequence[Closure], tree: Tree) -> Closed:
    """The closures of a tree, as columns. Raises `ProblemError` for bodies that it does not have."""
    rows, frames = (list[int](), list[int]()), (list[Pose](), list[Pose]())
    along, first, second = list[Any](), list[Any](), list[Any]()
    owners, weights = (list[int](), list[int](), list[int]()), (list[Any](), list[Any]())
    for i, closure in enumerate(closures):
        ends = zip((closure.parent, closure.child), closure.frames(), strict=True)
        for (end, own), held, poses in zip(ends, rows, frames, strict=True):
            if end is not None and end not in tree.places:
                raise ProblemError(
                    f"{kind}.closures: '{closure.name}' binds '{end}', which is no body; expected some of "
                    f"{sorted(tree.places)}, or None for the ground."
                )
            row, within = (GROUND, None) if end is None else tree.places[end]
            held.append(len(tree.above) if row == GROUND else row)
            poses.append(own if within is None else behind(within, own))
        directions, (outer, inner, own_weights) = closure.along(), closure.turned()
        along, first, second = [*along, *directions], [*first, *outer], [*second, *inner]
        # Equations of the point, then of the turns.
        points, turns = len(directions), len(own_weights)
        weights[0].append(np.eye(points, points + turns))
        weights[1].append(own_weights.T @ np.eye(turns, points + turns, points))
        for listed, count in zip(owners, (points, len(outer), points + turns), strict=True):
            listed += [i] * count
    poses = side_by_side(frames[0]), side_by_side(frames[1])
    turned = stacked(first, (3,)), stacked(second, (3,))
    by_points, by_pairs = (block_diagonal(np, np.zeros((0, 0)), *parts) for parts in weights)
    return Closed(tree, rows, poses, stacked(along, (3,)), turned, owners, (by_points, by_pairs))


def _with_ground(array: Any, ground: Any) -> Any:
    """Columns of rows, and behind them that of the ground."""
    last = np.broadcast_to(np.asarray(ground)[..., None], (*array.shape[:-1], 1))
    return library(array).concatenate([array, last], axis=-1)


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


def generalised(kind: str, tree: Tree, posture: Posture, loads: Any) -> Float[Array, " speeds"]:
    """The generalised force of the loads. Those on bodies fixed to the ground drop out.

    Raises `ProblemError` for anything but a load, and for an unknown body.
    """
    for load in members(f"{kind}.body_loads(q, v)", loads, BodyLoad):
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
    rows = [tree.places[load.body][0] for load in loads]
    force, moment = (
        jnp.stack([as_array(getattr(load, part), part, (3,)) for load in loads], axis=1) for part in ("force", "moment")
    )
    arms = columns(posture.arms, rows) + times(columns(posture.poses.rotation, rows), jnp.stack(at, axis=1))
    return along_screws(posture.screws, tree.carries[:, rows], Screws(moment + cross(arms, force), force))
