"""`Partition`: the elements of a germ's domain, and which of them a point lies in."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import in_library, jax_array
from aleator.analysis._box import Box
from aleator.expansion import Basis, GaussPoints, HammersleyPoints
from aleator.uncertainty import AbstractGerm

# Sample size for statistics that are no sums over elements.
POINTS = 2**14


class Scattered(NamedTuple):
    """Germ points sorted by element.

    - `matrices`: for each element, its polynomials at its points;
    - `back`: the index of each given point among the sorted ones.
    """

    matrices: list[Float[np.ndarray, "n terms"]]
    back: Int[np.ndarray, " points"]

    def evaluate(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "points *shape"]:
        """A piecewise expansion at the points, in the order given."""
        library, terms = in_library(coefficients)
        pieces = [library.tensordot(matrix, terms[k], axes=1) for k, matrix in enumerate(self.matrices) if len(matrix)]
        return jax_array(library.concatenate(pieces)[self.back])


@final
@dataclass(frozen=True, eq=False)
class Partition:
    """Boxes that fill a germ's probability space, with the orthonormal polynomials in each."""

    germs: Mapping[str, AbstractGerm]
    boxes: tuple[Box, ...]
    bases: tuple[Basis, ...]

    @property
    def probability(self) -> Float[np.ndarray, " elements"]:
        """The probability of each element."""
        return np.array([box.probability for box in self.boxes])

    def scatter(self, points: Float[np.ndarray, "points variables"]) -> Scattered:
        """Germ points by element."""
        levels = [germ.cumulative(points[:, i]) for i, germ in enumerate(self.germs.values())]
        owner = np.zeros(len(points), dtype=int)
        for k, box in enumerate(self.boxes):
            owner[box.holds(np.stack(levels, axis=1))] = k
        matrices = [basis.matrix(points[owner == k]) for k, basis in enumerate(self.bases)]
        return Scattered(matrices, np.argsort(np.argsort(owner, kind="stable"), kind="stable"))

    @cached_property
    def cloud(self) -> Scattered:
        """A low-discrepancy sample of the whole domain."""
        whole = Basis(self.germs, self.bases[0].indices)
        return self.scatter(whole.map_to_germ(HammersleyPoints(POINTS).levels(POINTS, whole.variables)))

    @cached_property
    def quadrature(self) -> list[tuple[Float[np.ndarray, "nodes terms"], Float[np.ndarray, " nodes"]]]:
        """For each element, its polynomials at Gauss nodes, with weights: exact for fourth powers of an expansion."""
        return [_gauss(basis) for basis in self.bases]


def _gauss(basis: Basis) -> tuple[np.ndarray, np.ndarray]:
    nodes = GaussPoints(2 * max(basis.degrees) + 1).nodes(basis, 0)
    return basis.matrix(nodes.points), nodes.weights
