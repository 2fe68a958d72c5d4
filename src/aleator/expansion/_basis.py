"""`Basis`: the multivariate orthonormal polynomials of an expansion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from aleator._core.memory import NUMBER, refuse_beyond_memory
from aleator.ensemble import at_levels
from aleator.expansion._index_set import SMALLER
from aleator.uncertainty import AbstractGerm

# The matrix, and the column of each of its entries in one variable.
_MATRICES = 2


@final
@dataclass(frozen=True, eq=False)
class Basis:
    """Products of univariate orthonormal polynomials, equation (16).

    - `germs`: the distribution of each germ variable, by name;
    - `indices`: degree of each variable in each term, shape (terms, variables); the first term is the constant.
    """

    germs: Mapping[str, AbstractGerm]
    indices: Int[np.ndarray, "terms variables"]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the germ variables, in the order of a germ vector."""
        return tuple(self.germs)

    @property
    def variables(self) -> int:
        """The number of germ variables `n_p`."""
        return len(self.germs)

    @property
    def terms(self) -> int:
        """The number of terms `n_b`."""
        return len(self.indices)

    @property
    def order(self) -> int:
        """The highest total degree of a term."""
        return int(self.indices.sum(axis=1).max())

    @property
    def degrees(self) -> tuple[int, ...]:
        """The highest degree of each variable."""
        return tuple(self.indices.max(axis=0).tolist())

    def matrix(self, points: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n terms"]:
        """The matrix `A[k, j] = Psi_j(xi_k)` of equation (28) at any number of germ points.

        Raises `ProblemError` if it would not fit into memory.
        """
        self.refuse_beyond_memory(len(points), _MATRICES)
        matrix = np.ones((len(points), self.terms))
        for i, (germ, degree) in enumerate(zip(self.germs.values(), self.degrees, strict=True)):
            matrix *= germ.polynomials(degree, points[:, i])[:, self.indices[:, i]]
        return matrix

    def refuse_beyond_memory(self, points: int, matrices: int) -> None:
        """Raise `ProblemError` if this number of matrices of points by terms would not fit into memory."""
        what = f"Expansion: {self.terms} terms in {self.variables} variables at {points} points"
        refuse_beyond_memory(what, NUMBER * matrices * points * self.terms, f"{SMALLER} Fewer points help too.")

    def map_to_germ(self, levels: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n variables"]:
        """Points of the unit cube as germ values, by the quantile functions."""
        return at_levels(self.germs.values(), levels)
