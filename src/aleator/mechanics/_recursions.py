"""Dynamics of trees of rigid bodies, by a few passes over their links.

Featherstone, Rigid Body Dynamics Algorithms, 2008. All quantities of a link are in its own frame. The loops over links
are unrolled.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator.mechanics._bodies import GROUND, Tree
from aleator.mechanics._matrices import solve_positive
from aleator.mechanics._spatial import (
    Articulated,
    Block,
    Numbers,
    Pose,
    Twist,
    Wrench,
    added,
    articulated,
    articulated_outside,
    composed,
    cross,
    cross_force,
    cross_motion,
    inertia_outside,
    library,
    load,
    momentum,
    plus,
    power,
    times,
    twist_within,
    wrench_outside,
)

_NO_MOTION = Twist(None, None)


class Moving(NamedTuple):
    """For each link its pose in its parent, its velocity, and the part of its acceleration that does not depend on
    `v̇`.
    """

    poses: list[Pose]
    twists: list[Twist]
    drifts: list[Twist]


def local_poses(tree: Tree, q: Float[Numbers, " coordinates"]) -> list[Pose]:
    """The pose of each link in its parent's frame."""
    return [link.joint.pose(link.placement, q[link.q]) for link in tree.links]


def world_poses(tree: Tree, q: Float[Numbers, " coordinates"]) -> list[Pose]:
    """The pose of each link in the world."""
    poses: list[Pose] = []
    for link, pose in zip(tree.links, local_poses(tree, q), strict=True):
        poses.append(pose if link.parent == GROUND else composed(poses[link.parent], pose))
    return poses


def moving(tree: Tree, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"]) -> Moving:
    """Poses, velocities and drifts, from the ground outwards."""
    found = Moving(local_poses(tree, q), [], [])
    for link, pose in zip(tree.links, found.poses, strict=True):
        own = link.joint.twist(q[link.q], v[link.v])
        carried = twist_within(pose, found.twists[link.parent]) if link.parent != GROUND else _NO_MOTION
        found.twists.append(added(carried, own))
        found.drifts.append(added(link.joint.drift(q[link.q], v[link.v]), cross_motion(carried, own)))
    return found


def inverse_dynamics(
    tree: Tree,
    gravity: Block,
    q: Float[Numbers, " coordinates"],
    v: Float[Numbers, " speeds"],
    v_dot: Float[Numbers, " speeds"],
) -> Float[Array, " speeds"]:
    """The generalised force of a motion, by the recursive Newton-Euler algorithm (table 5.1 there).

    Forces of springs and dampers are subtracted. Gravity is represented by an upward acceleration of the ground.
    """
    poses, twists, drifts = moving(tree, q, v)
    accelerations: list[Twist] = []
    wrenches: list[Wrench] = []
    for i, link in enumerate(tree.links):
        outer = Twist(None, -gravity) if link.parent == GROUND else accelerations[link.parent]
        own = link.joint.twist(q[link.q], v_dot[link.v])
        accelerations.append(added(twist_within(poses[i], outer), own, drifts[i]))
        moved = momentum(link.inertia, twists[i])
        wrenches.append(added(momentum(link.inertia, accelerations[i]), cross_force(twists[i], moved)))
    forces: list[Any] = []
    for i, link in reversed(list(enumerate(tree.links))):
        passive = link.joint.passive(q[link.q], v[link.v])
        accelerated = times(link.joint.rotors(), v_dot[link.v])
        forces.insert(0, plus(power(link.joint.subspace(q[link.q]), wrenches[i]), accelerated) - passive)
        if link.parent != GROUND:
            wrenches[link.parent] = added(wrenches[link.parent], wrench_outside(poses[i], wrenches[i]))
    return jax_array(library(*forces).concatenate([np.zeros(0), *forces]))


def motion_apart(
    tree: Tree, q: Float[Numbers, " coordinates"], poses: Mapping[str, Pose], first: int, second: int
) -> Twist:
    """How one link moves against another for each speed, as columns: at the world's origin and in its axes.

    `poses` are those of the bodies in the world, by name.
    """
    chains = [set(_chain(tree, index)) for index in (first, second)]
    angular: list[Any] = []
    linear: list[Any] = []
    for i, link in enumerate(tree.links):
        turning = moving = np.zeros((3, link.v.stop - link.v.start))
        if i in chains[0] ^ chains[1]:
            sign = 1.0 if i in chains[0] else -1.0
            own = link.joint.subspace(q[link.q])
            rotation, position = poses[link.name]
            turning = turning if own.angular is None else times(sign * rotation, own.angular)
            moving = moving if own.linear is None else times(sign * rotation, own.linear)
            moving = plus(moving, cross(position, turning))
        angular.append(turning)
        linear.append(moving)
    return Twist(jnp.concatenate(angular, axis=1), jnp.concatenate(linear, axis=1))


def _chain(tree: Tree, index: int) -> Iterator[int]:
    """A link and all that carry it."""
    while index != GROUND:
        yield index
        index = tree.links[index].parent


def generalised(tree: Tree, q: Float[Numbers, " coordinates"], loads: Sequence[Wrench]) -> Float[Array, " speeds"]:
    """The generalised force of a wrench on each link, in its own frame, by a pass from the leaves to the root."""
    poses, wrenches = local_poses(tree, q), list(loads)
    forces: list[Any] = []
    for i, link in reversed(list(enumerate(tree.links))):
        forces.insert(0, power(link.joint.subspace(q[link.q]), wrenches[i]))
        if link.parent != GROUND:
            wrenches[link.parent] = added(wrenches[link.parent], wrench_outside(poses[i], wrenches[i]))
    return jnp.concatenate([jnp.zeros(0), *forces])


def mass_matrix(tree: Tree, q: Float[Numbers, " coordinates"]) -> Float[Array, "speeds speeds"]:
    """The mass matrix, by the composite-rigid-body algorithm (table 6.2 there)."""
    poses = local_poses(tree, q)
    subspaces = [link.joint.subspace(q[link.q]) for link in tree.links]
    composite = [link.inertia for link in tree.links]
    sizes = [link.v.stop - link.v.start for link in tree.links]
    # Block by block: what is written into a matrix entry by entry takes long to compile.
    blocks: list[list[Any]] = [[np.zeros((m, n)) for n in sizes] for m in sizes]
    for i, link in reversed(list(enumerate(tree.links))):
        wrench = momentum(composite[i], subspaces[i])
        blocks[i][i] = plus(power(subspaces[i], wrench), link.joint.rotors())
        if link.parent != GROUND:
            composite[link.parent] = added(composite[link.parent], inertia_outside(poses[i], composite[i]))
        j = i
        while tree.links[j].parent != GROUND:
            wrench, j = wrench_outside(poses[j], wrench), tree.links[j].parent
            coupling = power(subspaces[j], wrench)
            if coupling is not None:
                blocks[j][i], blocks[i][j] = coupling, coupling.T
    if not blocks:
        return jnp.zeros((0, 0))
    xp = library(*(block for row in blocks for block in row))
    return jax_array(xp.concatenate([xp.concatenate(row, axis=1) for row in blocks]))


def forward_dynamics(
    tree: Tree,
    gravity: Block,
    q: Float[Numbers, " coordinates"],
    v: Float[Numbers, " speeds"],
    force: Float[Numbers, " speeds"],
) -> Float[Array, " speeds"]:
    """The acceleration under a generalised force, by the articulated-body algorithm (table 7.1 there).

    No mass matrix is formed. NaN where the inertia that a joint moves is singular.
    """
    poses, twists, drifts = moving(tree, q, v)
    subspaces = [link.joint.subspace(q[link.q]) for link in tree.links]
    inertias = [articulated(link.inertia) for link in tree.links]
    wrenches = [
        added(Wrench(np.zeros(3), np.zeros(3)), cross_force(twist, momentum(link.inertia, twist)))
        for link, twist in zip(tree.links, twists, strict=True)
    ]
    # For each link: its joint's own acceleration, and how the link's acceleration reduces it.
    own: list[Any] = [None] * len(tree.links)
    gains: list[Any] = [None] * len(tree.links)
    for i, link in reversed(list(enumerate(tree.links))):
        subspace = subspaces[i]
        wrenches[i] = added(wrenches[i], load(inertias[i], drifts[i]))
        carried = load(inertias[i], subspace)
        passive = link.joint.passive(q[link.q], v[link.v])
        rest = force[link.v] + passive - power(subspace, wrenches[i])
        right = jnp.concatenate([rest[:, None], carried.moment.T, carried.force.T], axis=1)
        solved = solve_positive(jnp.asarray(plus(power(subspace, carried), link.joint.rotors())), right)
        own[i], gains[i] = solved[:, 0], Twist(solved[:, 1:4], solved[:, 4:])
        if link.parent != GROUND:
            reduced = Articulated(
                inertias[i].angular - carried.moment @ gains[i].angular,
                inertias[i].mixed - carried.moment @ gains[i].linear,
                inertias[i].linear - carried.force @ gains[i].linear,
            )
            transmitted = added(wrenches[i], Wrench(carried.moment @ own[i], carried.force @ own[i]))
            inertias[link.parent] = added(inertias[link.parent], articulated_outside(poses[i], reduced))
            wrenches[link.parent] = added(wrenches[link.parent], wrench_outside(poses[i], transmitted))
    accelerations: list[Twist] = []
    found: list[Any] = []
    for i, link in enumerate(tree.links):
        outer = Twist(None, -gravity) if link.parent == GROUND else accelerations[link.parent]
        carried = twist_within(poses[i], outer)
        resisted = [times(gain, part) for gain, part in zip(gains[i], carried, strict=True) if part is not None]
        found.append(own[i] - sum(resisted))
        accelerations.append(added(carried, link.joint.twist(q[link.q], found[i]), drifts[i]))
    return jnp.concatenate([jnp.zeros(0), *found])
