"""`distance` of two shapes, many distances at once, and a smooth lower bound of the smallest."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.border import refusal, refuse_missing, traceable, whole
from aleator._core.errors import ProblemError
from aleator._core.leaves import stored_number
from aleator.geometry._shapes import (
    AbstractBounded,
    AbstractShape,
    Body,
    HalfSpace,
    cross,
    refuse_small,
    sign_table,
    unit,
)

ROUNDING = 1e-12
"""The gap between two cores, relative to their size, below which their nearest points define no direction."""

PARALLEL = 1e-14
"""The squared sine of the angle below which two directions count as parallel."""


def distance(first: AbstractShape, second: AbstractShape) -> Float[Array, ""]:
    """The signed distance (m) between two solid shapes: their gap, or minus the depth of their overlap.

    It is symmetric and exact for every pair: 0 at contact and, where they overlap, minus the penetration depth, which
    is the length of the shortest translation that separates them. The derivative is a unit direction that pushes them
    apart. It is finite and nonzero everywhere, even where centres coincide or a segment passes through the centre of an
    obstacle (one of the two sides is chosen there).

    Smoothness. The distance is Lipschitz continuous everywhere (a translation by `d` changes it by at most `|d|`).
    Outside the cores (the centre of a sphere, the segment of a capsule, the box itself) it is continuously
    differentiable, through contact and into the overlap of the rounded parts, except where the nearest points jump: at
    parallel segments, edges and faces, where a rotation moves them from one end to the other. Its second derivative
    jumps where a nearest point passes from the interior of a feature to its end. Where cores overlap (boxes; two
    segments that cross in the plane), and between a half-space and a segment or box, it is piecewise smooth, with kinks
    where another direction becomes the shortest way out or another vertex the lowest.

    Method. The difference of two cores is a convex polytope. Outside it, the distance is the minimum over pairs of
    features; inside, it follows from separating axes (Gottschalk, Lin and Manocha, 1996); radii are subtracted.

    Raises `ProblemError` if both are half-spaces, if one is in the plane and the other in space, or if a number is not
    realised.
    """
    if isinstance(first, AbstractBounded) and isinstance(second, AbstractBounded):
        bodies = first.body(), second.body()
        _check_dimensions((first, bodies[0].dimension), (second, bodies[1].dimension))
        return between_bodies(*bodies)
    if isinstance(first, AbstractBounded) and isinstance(second, HalfSpace):
        return _above(first, second)
    if isinstance(first, HalfSpace) and isinstance(second, AbstractBounded):
        return _above(second, first)
    raise ProblemError(
        "distance: expected two shapes (Sphere, Capsule, Box, HalfSpace) of which at most one is a HalfSpace; "
        f"received {type(first).__name__} and {type(second).__name__}."
    )


@jax.jit  # traced once for each pair of kinds, however often a model calls it
def between_bodies(first: Body, second: Body) -> Float[Array, ""]:
    """The signed distance of two bodies of the same dimension."""
    overlap = separation(first, second)
    size = jnp.sum(first.extents) + jnp.sum(second.extents) + jnp.sum(jnp.abs(first.center - second.center))
    is_apart = overlap > ROUNDING * size
    # The root is guarded before it is taken: its derivative at zero is infinite, even where it is not used.
    apart = jnp.sqrt(jnp.where(is_apart, squared_distance(first, second), 1.0))
    return jnp.where(is_apart, apart, overlap) - first.radius - second.radius


def _above(shape: AbstractBounded, solid: HalfSpace) -> Float[Array, ""]:
    """The height of a shape's lowest point above a plane."""
    body = shape.body()
    normal, offset = solid.plane()
    _check_dimensions((shape, body.dimension), (solid, normal.size))
    return body.center @ normal - offset - jnp.sum(jnp.abs(body.generators @ normal)) - body.radius


def _check_dimensions(first: tuple[AbstractShape, int], second: tuple[AbstractShape, int]) -> None:
    if first[1] != second[1]:
        one, other = (f"a {type(shape).__name__} in {size} dimensions" for shape, size in (first, second))
        raise ProblemError(f"distance: expected two shapes of the same space; received {one} and {other}.")


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


def link_distances(links: Sequence[AbstractBounded], apart: int = 2) -> Float[Array, " pairs"]:
    """The signed distances (m) between an arm's links, for a constraint against self-collision.

    `links` are the shapes of the links in order. Pairs whose places differ by less than `apart` are excluded, since
    neighbours share a joint and always touch. The others are in the order (0, apart), (0, apart + 1), ..., (1, 1 +
    apart), ...; see `distance` for each. Pairs of the same kinds of shapes are computed as one vector.

    Raises `ProblemError` if `apart` is not positive, if no pair is left, if a link is a half-space or if links lie in
    different spaces.
    """
    apart = whole("link_distances: 'apart'", apart)
    if not isinstance(links, Sequence):
        raise refusal("link_distances: 'links'", "shapes in a list", links)
    for place, link in enumerate(links):
        if not isinstance(link, AbstractBounded):
            raise ProblemError(
                f"link_distances: links are Sphere, Capsule or Box; link {place} is a {type(link).__name__}."
            )
    bodies = [link.body() for link in links]
    dimensions = [body.dimension for body in bodies]
    if len(set(dimensions)) > 1:
        raise ProblemError(f"link_distances: expected links of the same space; received dimensions {dimensions}.")
    pairs = [(i, j) for i in range(len(bodies)) for j in range(i + apart, len(bodies))]
    if not pairs:
        raise ProblemError(
            f"link_distances: no two of {len(bodies)} links are {apart} places from each other. Give at least "
            f"{apart + 1} links."
        )
    alike = defaultdict(list)
    for pair in pairs:
        alike[tuple(bodies[place].rank for place in pair)].append(pair)
    distances = [
        jax.vmap(between_bodies)(*(_stacked([bodies[place] for place in side]) for side in zip(*group, strict=True)))
        for group in alike.values()
    ]
    order = [pair for group in alike.values() for pair in group]
    return jnp.concatenate(distances)[jnp.array([order.index(pair) for pair in pairs])]


def smallest(distances: Any, sharpness: Any = 1e3) -> Float[Array, ""]:
    """A smooth lower bound of several distances: `-log(sum(exp(-sharpness * distances))) / sharpness`.

    It is never above the true minimum and at most `log(n) / sharpness` below it, for `n` distances: with the default of
    1000 per metre, 2.3 mm for ten distances. Where it is positive, so are all distances. The exact minimum is
    `jnp.min`, whose derivative jumps where another distance becomes the smallest.

    `distances` is an array of any shape, or a sequence of numbers (m); `sharpness` is in 1/m.

    Raises `ProblemError` if there are no distances, or if a plain sharpness is not positive.
    """
    sharpness = stored_number("smallest: 'sharpness'", sharpness)
    refuse_small("smallest: 'sharpness'", sharpness, may_vanish=False)
    refuse_missing("smallest: distances", distances)
    values = jnp.ravel(traceable("smallest: 'distances'", distances))
    if values.size == 0:
        raise ProblemError("smallest: expected at least one distance; received none.")
    # Relative to the minimum, no exponential overflows and the logarithm's argument is at least 1.
    least = jax.lax.stop_gradient(jnp.min(values))
    return least - jnp.log(jnp.sum(jnp.exp(-sharpness * (values - least)))) / sharpness


def _stacked(bodies: Sequence[Body]) -> Body:
    """Bodies of one rank as a single batch."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *bodies)
