"""`distance`: the signed distance of two shapes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.geometry._body import Body
from aleator.geometry._nearest import squared_distance
from aleator.geometry._separation import separation
from aleator.geometry._shapes import AbstractBounded, AbstractShape, HalfSpace

ROUNDING = 1e-12
"""The gap between two cores, relative to their size, below which their nearest points define no direction."""


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
