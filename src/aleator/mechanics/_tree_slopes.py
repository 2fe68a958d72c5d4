"""Derivatives of the inverse dynamics of trees of bodies by coordinates, velocities and accelerations, in closed form.

Singh, Russell, Wensing, Efficient Analytical Derivatives of Rigid-Body Dynamics using Spatial Vector Algebra, IEEE
Robotics and Automation Letters 7 (2022), equations (18) to (24): products of matrices of one column for each speed,
whose cost is that of a few evaluations, however many derivatives are asked for. Motions and loads are columns of six
numbers, angular before linear, in the world's axes and about the origins of their trees.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.mechanics._bodies import Inertia
from aleator.mechanics._spatial import Numbers, Pose, columns, library, skew, times
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
