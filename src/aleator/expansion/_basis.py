"""`Basis`: the multivariate orthonormal polynomials of an expansion, and the index sets that choose them."""

import abc
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import comb
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import NUMBER, in_library, jax_array, refuse_beyond_memory
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.ensemble import at_levels
from aleator.uncertainty import AbstractGerm

# Tolerance for rounding in sums of powers, so that indices on the edge of a set belong to it.
_ROUNDING = 1e-9

# Beyond this, the collocation matrix takes hundreds of gigabytes: three points a term, eight bytes a number.
_MOST_TERMS = 200_000

# Larger numbers are not printed.
_COUNTABLE = 1e30

SMALLER = (
    "Lower the order, or take a smaller index set: al.index_sets.HyperbolicCross(q) or "
    "al.index_sets.Anisotropic(weights)."
)
"""The remedy for a basis that is too large."""

# The matrix, and the column of each of its entries in one variable.
_MATRICES = 2


class AbstractIndexSet(Module):
    """Which multi-indices an expansion of a given order keeps.

    Sets are downward closed: they contain all divisors of each of their products. Terms are sorted by total degree,
    then by the degrees of the variables in turn, higher degrees first; the first term is the constant.
    """

    @abc.abstractmethod
    def indices(self, names: tuple[str, ...], order: int) -> Int[np.ndarray, "terms variables"]:
        """The degree of each variable in each term, for germ variables of these names."""


@final
class TotalDegree(AbstractIndexSet):
    """All multi-indices whose sum is at most the order: `(n_p + order)! / (n_p! order!)` terms."""

    @override
    def indices(self, names: tuple[str, ...], order: int) -> Int[np.ndarray, "terms variables"]:
        _refuse_too_many(comb(len(names) + order, order), len(names))
        return _within(np.tile(np.arange(order + 1.0), (len(names), 1)), order)


@final
class TensorProduct(AbstractIndexSet):
    """All multi-indices with every degree at most the order: `(order + 1)^n_p` terms, for few variables."""

    @override
    def indices(self, names: tuple[str, ...], order: int) -> Int[np.ndarray, "terms variables"]:
        _refuse_too_many((order + 1) ** len(names), len(names))
        return _within(np.zeros((len(names), order + 1)), 0.0)


@final
class HyperbolicCross(AbstractIndexSet):
    """All multi-indices whose q-norm `(sum of i^q)^(1/q)` is at most the order, with 0 < q <= 1.

    It keeps all powers of one variable and few products of many: the smaller q, the fewer; q = 1 is the total degree.
    Source: Blatman and Sudret (2011), Adaptive sparse polynomial chaos expansion based on least angle regression.
    """

    q: float = eqx.field(static=True)

    def __init__(self, q: float = 0.5):
        self.q = border.positive("HyperbolicCross: q, where 1 keeps the total degree,", q, most=1.0)

    @override
    def indices(self, names: tuple[str, ...], order: int) -> Int[np.ndarray, "terms variables"]:
        _refuse_too_many(1 + len(names) * order, len(names))  # the powers of single variables alone
        return _within(np.tile(np.arange(order + 1.0) ** self.q, (len(names), 1)), order**self.q)


@final
class Anisotropic(AbstractIndexSet):
    """All multi-indices whose weighted sum `sum of w_i i_i` is at most the order.

    `weights`: positive numbers, one for each germ variable in a sequence, or by name with 1 for those not named. A
    variable of weight 2 has degrees up to half the order, one of weight 1 up to the order.
    """

    weights: tuple[float, ...] = eqx.field(static=True)
    names: tuple[str, ...] | None = eqx.field(static=True)

    def __init__(self, weights: Sequence[float] | Mapping[str, float]):
        named = isinstance(weights, Mapping)
        if isinstance(weights, str) or not isinstance(weights, Iterable) or not tuple(weights):
            raise border.refusal("Anisotropic: weights", "positive numbers, one for each variable or by name", weights)
        each = weights.values() if named else weights
        numbers = tuple(border.positive("Anisotropic: weights", weight) for weight in each)
        self.weights, self.names = numbers, tuple(weights) if named else None

    @override
    def indices(self, names: tuple[str, ...], order: int) -> Int[np.ndarray, "terms variables"]:
        """Raises `ProblemError` if the weights are not those of the variables."""
        weights = self._of(names)
        _refuse_too_many(1 - len(names) + sum(order / weight for weight in weights.tolist()), len(names))
        return _within(weights[:, None] * np.arange(int(order / min(weights) + _ROUNDING) + 1), order)

    def _of(self, names: tuple[str, ...]) -> Float[np.ndarray, " variables"]:
        known = ", ".join(map(repr, names))
        if self.names is None:
            if len(self.weights) != len(names):
                raise ProblemError(
                    f"Anisotropic: expected one weight for each of the {len(names)} germ variables ({known}); received "
                    f"{len(self.weights)}."
                )
            return np.array(self.weights, dtype=float)
        unknown = ", ".join(repr(name) for name in self.names if name not in names)
        if unknown:
            raise ProblemError(f"Anisotropic: no germ variable is called {unknown}; there are {known}.")
        named = dict(zip(self.names, self.weights, strict=True))
        return np.array([named.get(name, 1.0) for name in names], dtype=float)


def sorted_terms(indices: Int[np.ndarray, "terms variables"]) -> Int[np.ndarray, "terms variables"]:
    """Terms in the order that `AbstractIndexSet` specifies."""
    return indices[np.lexsort((*(-indices.T)[::-1], indices.sum(axis=1)))]


def _within(costs: Float[np.ndarray, "variables degrees"], budget: float) -> Int[np.ndarray, "terms variables"]:
    """All multi-indices whose costs, `costs[i, degree]` for variable i, add up to at most the budget.

    Built variable by variable, so that every partial row is itself in the set and none is discarded. Costs rise with
    the degree and are zero for degree zero.
    """
    allowed = budget + _ROUNDING * max(budget, 1.0)
    rows, left = np.zeros((1, 0), dtype=int), np.array([allowed])
    for cost in costs:
        choices = np.searchsorted(cost, left, side="right")
        _refuse_too_many(int(choices.sum()), len(costs))
        parent = np.repeat(np.arange(len(rows)), choices)
        degree = np.arange(len(parent)) - np.repeat(np.cumsum(choices) - choices, choices)
        rows, left = np.column_stack([rows[parent], degree]), left[parent] - cost[degree]
    return sorted_terms(rows)


def _refuse_too_many(terms: float, variables: int) -> None:
    """Refuse a basis of this many terms, or more, before they are enumerated."""
    if not terms <= _MOST_TERMS:
        count = f"{terms:.3g}" if terms < _COUNTABLE else f"more than {_COUNTABLE:.0e}"
        raise ProblemError(
            f"Expansion: more than {_MOST_TERMS} terms in {variables} variables, at least {count}: their collocation "
            f"matrix alone would need hundreds of GiB of memory. {SMALLER}"
        )


class AbstractBasis(abc.ABC):
    """Orthonormal functions of the germ, the first of which is the constant.

    - `germs`: the distribution of each germ variable, by name;
    - `indices`: degree of each variable in each term, shape (terms, variables).
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

    @abc.abstractmethod
    def matrix(self, points: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n terms"]:
        """The matrix `A[k, j] = Psi_j(xi_k)` of equation (28) at any number of germ points.

        Raises `ProblemError` if it would not fit into memory.
        """

    def values(
        self, points: Float[np.ndarray, "n variables"], coefficients: Float[Array, "terms *shape"]
    ) -> Float[Array, "n *shape"]:
        """An expansion at germ points."""
        library, known = in_library(coefficients)
        return jax_array(library.tensordot(self.matrix(points), known, axes=1))

    def refuse_beyond_memory(self, points: int, matrices: int) -> None:
        """Raise `ProblemError` if this number of matrices of points by terms would not fit into memory."""
        what = f"Expansion: {self.terms} terms in {self.variables} variables at {points} points"
        refuse_beyond_memory(what, NUMBER * matrices * points * self.terms, f"{SMALLER} Fewer points help too.")

    def map_to_germ(self, levels: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n variables"]:
        """Points of the unit cube as germ values, by the quantile functions."""
        return at_levels(self.germs.values(), levels)


@final
@dataclass(frozen=True, eq=False)
class Basis(AbstractBasis):
    """Products of univariate orthonormal polynomials, equation (16)."""

    germs: Mapping[str, AbstractGerm]
    indices: Int[np.ndarray, "terms variables"]

    @override
    def matrix(self, points: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n terms"]:
        self.refuse_beyond_memory(len(points), _MATRICES)
        terms = np.ones((self.terms, len(points)))
        for i, (germ, degree) in enumerate(zip(self.germs.values(), self.degrees, strict=True)):
            in_it = np.flatnonzero(self.indices[:, i])  # of many variables, a small part of the terms
            terms[in_it] *= germ.polynomials(degree, points[:, i]).T[self.indices[in_it, i]]
        return np.ascontiguousarray(terms.T)
