"""Many distances at once: between an arm's links, and a smooth lower bound of the smallest."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator._core.given import refusal, refuse_missing, traceable, whole
from aleator.geometry._body import Body
from aleator.geometry._distance import between_bodies
from aleator.geometry._numbers import check_number, plain, stored
from aleator.geometry._shapes import AbstractBounded


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
    found = [
        jax.vmap(between_bodies)(*(_stacked([bodies[place] for place in side]) for side in zip(*group, strict=True)))
        for group in alike.values()
    ]
    order = [pair for group in alike.values() for pair in group]
    return jnp.concatenate(found)[jnp.array([order.index(pair) for pair in pairs])]


def smallest(distances: Any, sharpness: Any = 1e3) -> Float[Array, ""]:
    """A smooth lower bound of several distances: `-log(sum(exp(-sharpness * distances))) / sharpness`.

    It is never above the true minimum and at most `log(n) / sharpness` below it, for `n` distances: with the default of
    1000 per metre, 2.3 mm for ten distances. Where it is positive, so are all distances. The exact minimum is
    `jnp.min`, whose derivative jumps where another distance becomes the smallest.

    `distances` is an array of any shape, or a sequence of numbers (m); `sharpness` is in 1/m.

    Raises `ProblemError` if there are no distances, or if a plain sharpness is not positive.
    """
    sharpness = stored("smallest", "sharpness", sharpness)
    check_number("smallest", "sharpness", sharpness)
    known = plain(sharpness)
    if known is not None and not known > 0:
        raise ProblemError(f"smallest: 'sharpness' must be positive; received {known}.")
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
