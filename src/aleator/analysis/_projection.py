"""Projection onto the polynomials of a basis by quadrature over the germ: the inner product of equation (12)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator.expansion import Basis, Expansion, GaussPoints, SmolyakPoints

# Beyond this many quadrature nodes per evaluation of the equations, collocation is far better.
_MOST_NODES = 20_000


class Quadrature(NamedTuple):
    """Nodes of a quadrature over the germ, the polynomials there, and the projection onto them."""

    points: Float[Array, "nodes variables"]
    matrix: Float[Array, "nodes terms"]
    projection: Float[Array, "terms nodes"]

    def at_nodes(self, coefficients: Float[Array, "terms *shape"]) -> Float[Array, "nodes *shape"]:
        """An expansion at the nodes."""
        return jnp.tensordot(self.matrix, coefficients, axes=1)

    def project(self, values: Float[Array, "nodes *shape"]) -> Float[Array, "terms *shape"]:
        """The coefficients `<Psi_n, values>`."""
        return jnp.tensordot(self.projection, values, axes=1)


def quadrature_over(basis: Basis, expansion: Expansion) -> Quadrature:
    """The quadrature of the expansion's points, if they have one; else one exact for products of three polynomials."""
    named = isinstance(expansion.points, GaussPoints | SmolyakPoints)
    points = expansion.points if named else GaussPoints(3 * max(basis.degrees) // 2 + 2)
    nodes = points.nodes(basis, 0)
    if len(nodes.points) > _MOST_NODES:
        raise ProblemError(
            f"galerkin: the quadrature over {basis.variables} variables has {len(nodes.points)} nodes, at each of "
            f"which every evaluation needs the equations (limit {_MOST_NODES}). Lower the order, name "
            "points=al.points.SmolyakPoints(), or use al.expand."
        )
    matrix = basis.matrix(nodes.points)
    return Quadrature(*map(jax_array, (nodes.points, matrix, matrix.T * nodes.weights[None])))
