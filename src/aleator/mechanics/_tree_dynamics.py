"""Kinematics and dynamics of trees of rigid bodies, for all bodies at once, and derivatives of the dynamics.

In the world's axes, and about one point for a whole tree, the motion of a body is the sum of the motions of the joints
that carry it, and the load on a joint the sum of the loads on what it carries: products with known matrices of zeros
and ones, where recursions (Featherstone, Rigid Body Dynamics Algorithms, 2008) take a pass over the bodies. Only poses
are composed one after another, by doubling: a tree takes as many rounds as its depth has binary digits. So the number
of traced equations does not grow with that of bodies.

Derivatives by coordinates, velocities and accelerations are in closed form (Singh, Russell, Wensing, Efficient
Analytical Derivatives of Rigid-Body Dynamics using Spatial Vector Algebra, IEEE Robotics and Automation Letters 7
(2022), equations (18) to (24)): products of matrices of one column for each speed, whose cost is that of a few
evaluations, however many derivatives are asked for. There, motions and loads are columns of six numbers, angular before
linear.
"""

import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.equations import with_slope
from aleator.mechanics._bodies import Ball, Inertia, Revolute
from aleator.mechanics._matrices import solve_positive
from aleator.mechanics._spatial import (
    GROUND,
    Numbers,
    Pose,
    Screws,
    columns,
    combined,
    composed_upwards,
    cross,
    from_quaternions,
    is_known,
    library,
    product,
    quaternion_rates,
    scattered,
    skew,
    times,
    turned,
    unit_quaternions,
)
from aleator.mechanics._trees import Tree, moved


class Slopes(NamedTuple):
    """The derivatives of generalised forces by displacements along the speeds, by speeds and by accelerations."""

    by_place: Float[Array, "speeds speeds"]
    by_speed: Float[Array, "speeds speeds"]
    by_acceleration: Float[Array, "speeds speeds"]


def slopes(
    tree: Tree,
    poses: Pose,
    screws: Float[Numbers, "6 speeds"],
    gravity: Float[Numbers, " 3"],
    v: Float[Numbers, " speeds"],
    v_dot: Float[Numbers, " speeds"],
) -> Slopes:
    """Those of the bodies alone, without springs, dampers and rotors. `poses` are about the origins of the trees."""
    carried: Any = tree.carries[:, list(tree.carrier)]
    # Speeds of the same joint carry one another.
    above = carried * (1 - carried.T)
    upwards = library(gravity).concatenate([np.zeros(3), -gravity])[:, None]
    own = screws * v[None]
    outer = own @ above
    by_parent = times(_crossed(outer), screws)
    by_body = times(_crossed(own @ carried), screws)
    changes = by_body * v[None] + screws * v_dot[None]
    twice = times(_crossed(changes @ above + upwards), screws) + times(_crossed(outer), by_parent)
    n = len(v)
    composite: list[Any] = [np.zeros((6, 6, n)), np.zeros((6, 6, n)), np.zeros((6, n))]
    for rows, inertia in tree.lumps:
        places = list(rows)
        lump = _matrix(moved(inertia, Pose(*(columns(part, places) for part in poses))))
        motion, acceleration = own @ tree.carries[:, places], changes @ tree.carries[:, places] + upwards
        momentum, across = times(lump, motion), _crossed(motion)
        # 2 B of equation (12): `v ×* I - I v × + (I v) ×̄*`.
        turning = -jnp.einsum("jin,jkn->ikn", across, lump) - jnp.einsum("ijn,jkn->ikn", lump, across)
        turning = turning + _borne(momentum)
        load = times(lump, acceleration) - jnp.einsum("jin,jn->in", across, momentum)
        parts = lump, turning, load
        composite = [before + part @ tree.carries[:, places].T for before, part in zip(composite, parts, strict=True)]
    inertia, turning, load = composite
    moved_by = by_parent + by_body
    inert, turned = times(inertia, screws), jnp.einsum("jin,jn->in", turning, screws)
    # Rows of what a joint carries, by what carries it; and the other way round.
    inner = [
        turned.T @ by_parent + inert.T @ twice,
        turned.T @ screws + inert.T @ moved_by,
        inert.T @ screws,
    ]
    outwards = [
        times(turning, by_parent) + times(inertia, twice) + times(_borne(load), screws),
        times(turning, screws) + times(inertia, moved_by),
        inert,
    ]
    pairs = zip(inner, outwards, strict=True)
    return Slopes(*(carried.T * down + above * (screws.T @ up) for down, up in pairs))


def _blocks(rows: list[list[Any]]) -> Any:
    return jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows])


def _crossed(motion: Float[Numbers, "6 n"]) -> Float[Numbers, "6 6 n"]:
    """The matrices of `v ×` of motions; minus their transposes are those of `v ×*` of loads."""
    turning, moving = skew(motion[:3]), skew(motion[3:])
    return _blocks([[turning, jnp.zeros_like(turning)], [moving, turning]])


def _borne(load: Float[Numbers, "6 n"]) -> Float[Numbers, "6 6 n"]:
    """The matrices of `f ×̄*`, whose products with motions `v` are `v ×* f`."""
    moment, force = skew(load[:3]), skew(load[3:])
    return -_blocks([[moment, force], [force, jnp.zeros_like(force)]])


def _matrix(inertia: Inertia) -> Float[Numbers, "6 6 n"]:
    across = skew(inertia.first)
    return _blocks([[inertia.second, across], [-across, np.eye(3)[..., None] * inertia.mass[None, None]]])


class Posture(NamedTuple):
    """A tree in one posture.

    - `poses`: of the rows in the world; `arms` (3, rows): their origins from that of the tree that they belong to, m;
    - `screws`: the motion by each speed alone, about the origin of its tree.
    """

    poses: Pose
    arms: Float[Numbers, "3 rows"]
    screws: Screws


def posture_of(tree: Tree, q: Float[Numbers, " coordinates"]) -> Posture:
    """The posture at some coordinates."""
    poses = composed_upwards(_in_frames_above(tree, q), tree.above)
    # Far from the world's origin, moments about it would lose digits.
    arms = poses.position - columns(poses.position, [_root(tree, row) for row in range(len(tree.above))])
    axes = times(columns(poses.rotation, tree.carrier), tree.axes)
    turning = axes * tree.turns[None]
    moved = cross(columns(arms, tree.carrier), turning)
    return Posture(poses, arms, Screws(turning, moved if tree.turns.all() else axes - turning + moved))


def _in_frames_above(tree: Tree, q: Float[Numbers, " coordinates"]) -> Pose:
    """The pose of each row in the frame of the row above."""
    rotation, position = tree.placement
    hinges, balls = tree.rows(Revolute), tree.rows(Ball)
    rigid = [row for row in range(len(tree.above)) if row not in (*hinges, *balls)]
    about, angles = columns(tree.axes, _speeds(tree, hinges)), columns(q, tree.coordinates(hinges))
    parts = [
        (hinges, turned(columns(rotation, hinges), about, angles)),
        (rigid, columns(rotation, rigid)),
    ]
    if balls:
        quaternions = columns(q, tree.coordinates(balls)).reshape(-1, 4).T
        parts.append((balls, product(columns(rotation, balls), from_quaternions(quaternions))))
    if tree.turns.all():
        return Pose(scattered(parts), position)
    own = np.array([[float(row == carrier) for row in range(len(tree.above))] for carrier in tree.carrier])
    moved = (tree.axes * ((1 - tree.turns) * along_speeds(tree, q))[None]) @ own
    return Pose(scattered(parts), position + times(rotation, moved))


def along_speeds(tree: Tree, q: Float[Numbers, " coordinates"]) -> Float[Numbers, " speeds"]:
    """The coordinate whose rate each speed is; zero for those of balls."""
    balls = tree.rows(Ball)
    if not balls:
        return q
    turning = _speeds(tree, balls)
    places = [place for place in range(tree.axes.shape[1]) if place not in turning]
    rows = [row for row in range(len(tree.kinds)) if row not in balls]
    return scattered([(places, columns(q, sorted(tree.coordinates(rows)))), (turning, np.zeros(len(turning)))])


def _speeds(tree: Tree, rows: Sequence[int]) -> list[int]:
    return [place for row in rows for place in range(tree.v[row].start, tree.v[row].stop)]


def _root(tree: Tree, row: int) -> int:
    while tree.above[row] != GROUND:
        row = tree.above[row]
    return row


def inverse_dynamics(
    tree: Tree,
    gravity: Float[Numbers, " 3"],
    q: Float[Numbers, " coordinates"],
    v: Float[Numbers, " speeds"],
    v_dot: Float[Numbers, " speeds"] | None = None,
) -> Float[Array, " speeds"]:
    """The generalised force of a motion, by default of one without acceleration.

    Forces of springs and dampers are subtracted. Gravity is represented by an upward acceleration of the ground.
    """

    def force(system: _System, q: Any, v: Any, v_dot: Any) -> Any:
        return _force(system.tree, posture_of(system.tree, q), system.gravity, q, v, v_dot)

    def slope(system: _System, needed: Any, state: Sequence[Any], changes: Sequence[Any]) -> Array:
        del needed
        by = _slopes(system, *state)
        changed = by.by_place @ _displacement(system.tree, state[0], changes[0]) + by.by_speed @ changes[1]
        return changed if changes[2] is None else changed + by.by_acceleration @ changes[2]

    return jax_array(with_slope(force, slope, _System(tree, gravity), q, v, v_dot))


def forward_dynamics(
    tree: Tree,
    gravity: Float[Numbers, " 3"],
    q: Float[Numbers, " coordinates"],
    v: Float[Numbers, " speeds"],
    force: Float[Numbers, " speeds"],
) -> Float[Array, " speeds"]:
    """The acceleration under a generalised force. NaN where the mass matrix is singular."""

    def acceleration(system: _System, q: Any, v: Any, force: Any) -> Any:
        posture = posture_of(system.tree, q)
        rest = force - _force(system.tree, posture, system.gravity, q, v, None)
        return solve_positive(mass_matrix(system.tree, posture), rest)

    def slope(system: _System, v_dot: Any, state: Sequence[Any], changes: Sequence[Any]) -> Array:
        by = _slopes(system, state[0], state[1], v_dot)
        rest = changes[2] - by.by_place @ _displacement(system.tree, state[0], changes[0]) - by.by_speed @ changes[1]
        return solve_positive(by.by_acceleration, rest)

    return jax_array(with_slope(acceleration, slope, _System(tree, gravity), q, v, force))


class _System(NamedTuple):
    """A tree under gravity (3,), m/s²."""

    tree: Tree
    gravity: Any


def _slopes(system: _System, q: Any, v: Any, v_dot: Any) -> Slopes:
    tree, posture = system.tree, posture_of(system.tree, q)
    poses = Pose(posture.poses.rotation, posture.arms)
    v_dot = np.zeros(tree.axes.shape[1]) if v_dot is None else v_dot
    of_bodies = slopes(tree, poses, jnp.concatenate(posture.screws), system.gravity, v, v_dot)
    passive = tree.stiffness, tree.damping, tree.armature
    return Slopes(*(of if _is_zero(own) else of + jnp.diag(own) for of, own in zip(of_bodies, passive, strict=True)))


def _displacement(tree: Tree, q: Any, change: Any) -> Any:
    """A change of coordinates as one along the speeds: the inverse of the velocity map."""
    balls = tree.rows(Ball)
    if not balls:
        return change
    turning = tree.coordinates(balls)
    others = [place for place in range(len(q)) if place not in turning]
    lengths = jnp.sqrt((columns(q, turning).reshape(-1, 4) ** 2).sum(1, keepdims=True))
    # The map of a quaternion of length l has orthogonal columns of length 1/2, and its inverse rows of length 2 / l.
    scales = scattered([(others, np.ones(len(others))), (turning, jnp.ravel(4.0 / lengths * np.ones((1, 4))))])
    return velocity_map(tree, q).T @ (scales * change)


def _force(tree: Tree, posture: Posture, gravity: Any, q: Any, v: Any, v_dot: Any) -> Any:
    own = _scaled(posture.screws, v)
    # An axis moves with the row whose joint it belongs to.
    outer = _summed(own, tree.carries[:, list(tree.carrier)])
    across = skew(outer.angular)
    changes = Screws(times(across, own.angular), times(across, own.linear) + cross(outer.linear, own.angular))
    if v_dot is not None:
        changes = Screws(*map(operator.add, changes, _scaled(posture.screws, v_dot)))
    motion, acceleration = _summed(own, tree.carries), _summed(changes, tree.carries)
    spin, rotation = skew(motion.angular), posture.poses.rotation
    # What gives the acceleration of a point beside that of its row's origin.
    apart = skew(acceleration.angular) + product(spin, spin)
    origins = acceleration.linear - gravity[:, None] + times(apart, posture.arms) + times(spin, motion.linear)
    within = library(rotation).swapaxes(rotation, 0, 1)
    by_second = rotation[:, :, None] * times(within, acceleration.angular)[None, None]
    by_second = by_second + product(spin, rotation)[:, :, None] * times(within, motion.angular)[None, None]
    by_first = product(apart, rotation), product(skew(origins), rotation)
    needed: Any = np.zeros(tree.axes.shape[1])
    # Masses and moments come last, since of all numbers these differ most often between systems on the same motion.
    for rows, (mass, first, second) in tree.lumps:
        force = mass[None] * columns(origins, rows) + times(columns(by_first[0], rows), first)
        moment = combined(columns(by_second, rows), second) - times(columns(by_first[1], rows), first)
        load = Screws(moment + cross(columns(posture.arms, rows), force), force)
        needed = needed + along_screws(posture.screws, tree.carries[:, list(rows)], load)
    if not _is_zero(tree.damping):
        needed = needed + tree.damping * v
    if not _is_zero(tree.stiffness):
        needed = needed + tree.stiffness * (along_speeds(tree, q) - tree.rest)
    return needed if v_dot is None or _is_zero(tree.armature) else needed + tree.armature * v_dot


def _scaled(screws: Screws, v: Float[Numbers, " speeds"]) -> Screws:
    return Screws(*(part * v[None] for part in screws))


def _summed(screws: Screws, carries: Float[np.ndarray, "m n"]) -> Screws:
    """The sum, for each column, of what moves it, or of what it carries."""
    return Screws(*(part @ carries for part in screws))


def _is_zero(values: Any) -> bool:
    return is_known(values) and not np.any(values)


def along_screws(screws: Screws, carries: Float[np.ndarray, "speeds n"], loads: Screws) -> Float[Numbers, " speeds"]:
    """The generalised force of loads on some rows, about the origins of their trees."""
    borne = _summed(loads, carries.T)
    return (screws.angular * borne.angular + screws.linear * borne.linear).sum(0)


def mass_matrix(tree: Tree, posture: Posture) -> Float[Array, "speeds speeds"]:
    """The mass matrix: for each speed, the momentum of all that it carries, along the speeds that carry its joint."""
    # Of all that each speed carries, about the origin of the tree.
    n = tree.axes.shape[1]
    total: list[Any] = [np.zeros(n), np.zeros((3, n)), np.zeros((3, 3, n))]
    for rows, inertia in tree.lumps:
        places = Pose(*(columns(part, rows) for part in (posture.poses.rotation, posture.arms)))
        borne = tree.carries[:, list(rows)].T
        total = [before + part @ borne for before, part in zip(total, moved(inertia, places), strict=True)]
    mass, first, second = total[0], skew(total[1]), total[2]
    screws = posture.screws
    linear = mass[None] * screws.linear - times(first, screws.angular)
    angular = times(second, screws.angular) + times(first, screws.linear)
    products = screws.angular.T @ angular + screws.linear.T @ linear
    # Entry (j, k): speed j carries the joint of k, or belongs to it; the others by symmetry.
    carried = tree.carries[:, list(tree.carrier)]
    matrix = carried * products + (carried * (1 - carried.T) * products).T
    return jax_array(matrix if _is_zero(tree.armature) else matrix + library(tree.armature).diag(tree.armature))


def potential_energy(
    tree: Tree, posture: Posture, gravity: Float[Numbers, " 3"], q: Float[Numbers, " coordinates"]
) -> Float[Array, ""]:
    """The energy of gravity (zero at the world's origin) and of springs, J."""
    poses = posture.poses
    energy = 0.5 * (tree.stiffness * (along_speeds(tree, q) - tree.rest) ** 2).sum()
    for rows, (mass, first, _) in tree.lumps:
        moments = columns(poses.position, rows) @ mass + times(columns(poses.rotation, rows), first).sum(1)
        energy = energy - gravity @ moments
    return energy


def velocity_map(tree: Tree, q: Float[Numbers, " coordinates"]) -> Float[Array, "coordinates speeds"]:
    """`H(q)`, with `q̇ = H(q) v`: ones, and a block for each quaternion."""
    balls = tree.rows(Ball)
    known = np.zeros((len(q), tree.axes.shape[1]))
    for row in range(len(tree.kinds)):
        if row not in balls:
            known[tree.q[row], tree.v[row]] = np.eye(tree.q[row].stop - tree.q[row].start)
    if not balls:
        return jax_array(known)
    places = np.zeros((4, 3, len(balls), *known.shape))
    for i, row in enumerate(balls):
        for j, k in np.ndindex(4, 3):
            places[j, k, i, tree.q[row].start + j, tree.v[row].start + k] = 1.0
    blocks = quaternion_rates(columns(q, tree.coordinates(balls)).reshape(-1, 4).T)
    return jax_array(known + library(blocks).tensordot(blocks, places, 3))


def unit_coordinates(turning: Sequence[int], q: Float[Numbers, " coordinates"]) -> Float[Numbers, " coordinates"]:
    """Coordinates with quaternions normalised, whose places are given; a zero quaternion becomes the identity."""
    others = [place for place in range(len(q)) if place not in turning]
    units = unit_quaternions(columns(q, turning).reshape(-1, 4).T).T.reshape(-1)
    return scattered([(others, columns(q, others)), (turning, units)])


def jacobian_at(tree: Tree, posture: Posture, row: int, point: Float[Numbers, " 3"]) -> Screws:
    """How a row turns, and the point of it at some place in the world moves, for each speed, (3, speeds)."""
    if row == GROUND:
        return Screws(np.zeros(tree.axes.shape), np.zeros(tree.axes.shape))
    angular, linear = (part * tree.carries[:, row][None] for part in posture.screws)
    arm = point - posture.poses.position[:, row] + posture.arms[:, row]
    return Screws(angular, linear - skew(arm[:, None])[..., 0] @ angular)
