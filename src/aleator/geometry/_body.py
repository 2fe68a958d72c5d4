"""`Body`: the common form of bounded shapes, a box of any rank with rounded edges."""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

TINY = 1e-200
"""A squared length below which a vector has no direction."""


class Body(NamedTuple):
    """All points within `radius` of the core `center + sum_i s_i directions_i`, `|s_i| <= extents_i`.

    The `k` directions are orthonormal: none for a sphere, one for a capsule, all for a box.
    """

    center: Float[Array, " d"]
    directions: Float[Array, "k d"]
    extents: Float[Array, " k"]
    radius: Float[Array, ""]

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.center.shape[-1]

    @property
    def rank(self) -> int:
        """The number of directions in which the core extends."""
        return self.extents.shape[-1]

    @property
    def generators(self) -> Float[Array, "k d"]:
        """The half edges of the core, as vectors."""
        return self.extents[:, None] * self.directions

    def points(self, signs: Float[np.ndarray, "n k"]) -> Float[Array, "n d"]:
        """The points of the core at the given multiples of its half edges."""
        return self.center[None, :] + jnp.asarray(signs) @ self.generators

    def vertices(self) -> Float[Array, "n d"]:
        """The `2^k` vertices of the core."""
        return self.points(sign_table(self.rank))


def sign_table(rank: int) -> Float[np.ndarray, "n k"]:
    """Every choice of `rank` signs, one per row."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=rank))).reshape(2**rank, rank)


def unit(
    vectors: Float[Array, "*n d"], smallest_square: float
) -> tuple[Float[Array, "*n d"], Float[Array, "*n"], Array]:
    """Unit vectors, their original lengths, and which of them were long enough to be normalised.

    A vector that is too short is returned unchanged with length 0; its derivatives are finite.
    """
    squares = jnp.sum(vectors**2, axis=-1)
    is_long = squares > smallest_square
    # The argument of the root is guarded: its derivative at zero is infinite, even in a branch that is not used.
    lengths = jnp.sqrt(jnp.where(is_long, squares, 1.0))
    return vectors / lengths[..., None], jnp.where(is_long, lengths, 0.0), is_long


def cross(first: Float[Array, "*n 3"], second: Float[Array, "*m 3"]) -> Float[Array, "*nm 3"]:
    """The cross product, in fewer operations than `jnp.cross`, since it is compiled many times."""
    after, before = np.array([1, 2, 0]), np.array([2, 0, 1])
    return first[..., after] * second[..., before] - first[..., before] * second[..., after]
