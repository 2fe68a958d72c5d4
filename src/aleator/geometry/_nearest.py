"""The squared distance between two disjoint cores: the minimum over all pairs of features."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.geometry._body import Body, cross, sign_table
from aleator.geometry._separation import PARALLEL


def squared_distance(first: Body, second: Body) -> Float[Array, ""]:
    """The squared distance between two disjoint cores.

    The nearest points of convex polytopes lie on a vertex of one of them or, in space, on an edge of each. Every pair
    of features gives two points of the cores, so that no candidate is below the distance and the least is exact.
    """
    few, many = (first, second) if first.rank <= second.rank else (second, first)
    candidates = [_from_vertices(few, many)]
    if few.rank:
        candidates.append(_from_vertices(many, few))
        if few.dimension == 3:
            candidates.append(_between_edges(few, many))
    return jnp.min(jnp.concatenate(candidates))


def _from_vertices(body: Body, other: Body) -> Float[Array, " n"]:
    """The squared distance of each vertex of one core to the other core."""
    apart = body.vertices() - other.center[None, :]
    reach = other.extents[None, :]
    nearest = jnp.clip(apart @ other.directions.T, -reach, reach) @ other.directions
    return jnp.sum((apart - nearest) ** 2, axis=1)


def _between_edges(first: Body, second: Body) -> Float[Array, " n"]:
    """The squared distance of each edge of one core to each of the other, where both nearest points are interior.

    Where they are not, the two points are not the nearest, but then a vertex is closer.
    """
    one, other = first.directions[:, None, :], second.directions[None, :, :]
    normals = cross(one, other)
    squares = jnp.sum(normals**2, axis=-1, keepdims=True)
    crosses = squares > PARALLEL
    # For parallel edges any two points will do, since a vertex is as near.
    normals = jnp.where(crosses, normals / jnp.where(crosses, squares, 1.0), 0.0)
    apart = _edge_centers(second)[None, None] - _edge_centers(first)[:, :, None, None]
    on_first, on_second = (
        jnp.clip(jnp.einsum("ipjqx,ijx->ipjq", apart, cross(direction, normals)), -reach, reach)[..., None]
        for direction, reach in (
            (other, first.extents[:, None, None, None]),
            (one, second.extents[None, None, :, None]),
        )
    )
    between = apart + on_second * other[:, None, :, None] - on_first * one[:, None, :, None]
    return jnp.sum(between**2, axis=-1).ravel()


def _edge_centers(body: Body) -> Float[Array, "k m 3"]:
    """The midpoint of each edge, by direction."""
    signs = [np.insert(sign_table(body.rank - 1), i, 0.0, axis=1) for i in range(body.rank)]
    return body.points(np.concatenate(signs)).reshape(body.rank, -1, 3)
