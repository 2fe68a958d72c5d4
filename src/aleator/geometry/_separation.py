"""The overlap of two bodies' cores by separating axes."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.geometry._body import Body, cross, unit

PARALLEL = 1e-14
"""The squared sine of the angle below which two directions count as parallel."""


def separation(first: Body, second: Body) -> Float[Array, ""]:
    """The largest gap between the cores along any of their separating axes.

    It is positive exactly where the cores are disjoint, and then no larger than their distance. Elsewhere it is minus
    their penetration depth: the difference of two boxes is a polytope whose faces have these axes as normals. It is
    always the gap along a single axis, and so piecewise smooth: derivatives of an average over axes might cancel.
    """
    axes, exists = _axes(first, second)
    generators = jnp.concatenate([first.generators, second.generators])
    along = axes @ (second.center - first.center)
    # Not `abs`: where centres coincide along an axis, one side is chosen, so that the derivative does not vanish.
    gaps = jnp.where(along >= 0, along, -along) - jnp.sum(jnp.abs(axes @ generators.T), axis=1)
    gaps = jnp.where(exists, gaps, -jnp.inf)
    return gaps[jnp.argmax(gaps)]


def _axes(first: Body, second: Body) -> tuple[Float[Array, "n d"], Array]:
    """Unit vectors, among them all normals of the cores' difference, and which of them exist."""
    frames = [_frame(body) for body in (first, second) if body.rank]
    own = jnp.concatenate(frames) if frames else jnp.eye(first.dimension)
    is_own = jnp.ones(own.shape[0], dtype=bool)
    if first.dimension == 2 or not (first.rank and second.rank):
        return own, is_own
    crossed, exists = _crossed(first, second)
    return jnp.concatenate([own, crossed]), jnp.concatenate([is_own, exists])


def _crossed(first: Body, second: Body) -> tuple[Float[Array, "n 3"], Array]:
    """The common normals of an edge of each body; for two segments also the normals in the plane that they span."""
    pairs = cross(first.directions[:, None, :], second.directions[None, :, :])
    normals, _, exists = unit(pairs.reshape(-1, 3), PARALLEL)
    if first.rank > 1 or second.rank > 1:
        return normals, exists
    in_plane = [cross(normals, body.directions) for body in (first, second)]
    return jnp.concatenate([normals, *in_plane]), jnp.tile(exists, 3)


def _frame(body: Body) -> Float[Array, "d d"]:
    """An orthonormal basis that starts with the body's own directions."""
    if body.rank == body.dimension:
        return body.directions
    direction = body.directions[0]
    if body.dimension == 2:
        return jnp.stack([direction, jnp.stack([-direction[1], direction[0]])])
    # The cross product with the coordinate axis least parallel to it.
    away = jnp.eye(3)[jnp.argmin(jnp.abs(direction))]
    second, _, _ = unit(cross(direction, away), PARALLEL)
    return jnp.stack([direction, second, cross(direction, second)])
