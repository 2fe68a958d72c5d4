"""`PiecewiseBasis`: the orthonormal polynomials of elements, each a cell of the germ's domain: multi-element gPC,
[11]-[16].

Polynomials that are orthonormal in a cell of probability `P`, divided by `√P` and zero elsewhere, are orthonormal over
the whole domain. Of the functions that are constant in each cell, the first is turned into the constant of all by
Householder's reflection. So the coefficients of a piecewise expansion have the moments of any other (equations 30-33).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import Pytree, alike, in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion._basis import AbstractBasis
from aleator.expansion._collocation import Collocation
from aleator.uncertainty import AbstractGerm, LegendreGerm, SampleGerm
from aleator.uncertainty._measure import recurrence_of
from aleator.uncertainty._quantiles import tanh_sinh

# Probability levels that cluster at both ends of an element, with their weights.
_LEVELS, _WEIGHTS = tanh_sinh(240, -4.0, 4.0)


def restricted(germ: AbstractGerm, low: float, high: float) -> AbstractGerm:
    """The distribution of `germ` given that its probability level lies between `low` and `high`."""
    return germ if (low, high) == (0.0, 1.0) else RestrictedGerm(germ, low, high)


@final
@dataclass(frozen=True)
class RestrictedGerm(AbstractGerm):
    """The distribution of `germ` given that its probability level lies between `low` and `high`.

    Its values are those of `germ` itself. A restricted uniform distribution is uniform. The polynomials of any other
    follow by Stieltjes' procedure from quadrature over the levels (Wan and Karniadakis, 2006, Multi-element generalized
    polynomial chaos for arbitrary probability measures).
    """

    germ: AbstractGerm
    low: float
    high: float

    @override
    def recurrence(self, order: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        if isinstance(self.germ, LegendreGerm):
            a, b = self.germ.recurrence(order)
            return a + (self.low + self.high - 1), b * (self.high - self.low)
        a, b, _ = recurrence_of(*self._quadrature(), order)
        return a, b

    @override
    def quantile(self, level: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        # Rounding may not put a level at the infinite end of an unbounded distribution.
        levels = self.low + level * (self.high - self.low)
        return self.germ.quantile(levels if self.high < 1 else np.minimum(levels, 1 - np.finfo(float).epsneg))

    @override
    def cumulative(self, germ: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.clip((self.germ.cumulative(germ) - self.low) / (self.high - self.low), 0.0, 1.0)

    @override
    def support(self) -> tuple[float, float]:
        first, last = self.germ.support()
        low = first if self.low == 0 else float(self.germ.quantile(np.array(self.low)))
        high = last if self.high == 1 else float(self.germ.quantile(np.array(self.high)))
        return low, high

    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Germ values and probability weights. The nodes cluster at an end of an unbounded distribution."""
        levels = self.low + _LEVELS * (self.high - self.low)
        inside = (levels > 0) & (levels < 1)
        return self.germ.quantile(levels[inside]), _WEIGHTS[inside] / _WEIGHTS[inside].sum()


@final
@dataclass(frozen=True)
class Cell:
    """The probability levels of each germ variable between `low` and `high`."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def probability(self) -> float:
        """The probability that the germ lies in the cell."""
        return float(np.prod(np.subtract(self.high, self.low)))

    def halves(self, variable: int) -> tuple["Cell", "Cell"]:
        """Two cells of equal probability, from a cut across one variable."""
        middle = (self.low[variable] + self.high[variable]) / 2

        def at_middle(ends: tuple[float, ...]) -> tuple[float, ...]:
            return (*ends[:variable], middle, *ends[variable + 1 :])

        return Cell(self.low, at_middle(self.high)), Cell(at_middle(self.low), self.high)

    def germs(self, germs: Mapping[str, AbstractGerm]) -> dict[str, AbstractGerm]:
        """The distributions of the germ variables, conditional on the cell. Raises `ProblemError` for data."""
        for name, germ in germs.items():
            if isinstance(germ, SampleGerm):
                count = germ.values.size
                raise ProblemError(
                    f"al.MultiElement divides densities; received an al.Sample for '{name}', whose {count} values are "
                    f"exact by al.Expansion(order={count - 1}). For others between, fit a density."
                )
        limits = zip(germs.items(), self.low, self.high, strict=True)
        return {name: restricted(germ, low, high) for (name, germ), low, high in limits}

    def holds(self, levels: Float[np.ndarray, "n variables"]) -> Bool[np.ndarray, " n"]:
        """Which points of the unit cube lie in the cell. A face between two cells belongs to the upper one."""
        low, high = np.array(self.low)[None], np.array(self.high)[None]
        return np.all((levels >= low) & ((levels < high) | (high == 1)), axis=1)


@final
class Division(Module):
    """How the coefficients of a piecewise expansion become those of its elements.

    - `mirror`: of the constants, symmetric and orthogonal, its first column the `roots` of the probabilities.
    """

    mirror: Float[Array, "elements elements"]
    roots: Float[Array, " elements"]

    @property
    def probability(self) -> Float[Array, " elements"]:
        """The probability of each element."""
        return self.roots**2

    def elements(self, whole: Float[Any, "all_terms *shape"]) -> Float[Any, "elements terms *shape"]:
        """The coefficients in each element, in polynomials that are orthonormal there."""
        _, known = in_library(whole)
        count = len(self.roots)
        parts = self._turned(known.reshape(count, len(known) // count, *known.shape[1:]), first=True)
        return alike(parts, whole)

    def whole(self, elements: Float[Any, "elements terms *shape"]) -> Float[Any, "all_terms *shape"]:
        """The reverse."""
        parts = self._turned(elements, first=False)
        # Not by -1: there may be nothing in each.
        return alike(parts.reshape(parts.shape[0] * parts.shape[1], *parts.shape[2:]), elements)

    def _turned(self, parts: Any, *, first: bool) -> Any:
        library, parts, mirror, roots = in_library(parts, self.mirror, self.roots)
        factors = roots.reshape(-1, *[1] * (parts.ndim - 1))
        parts = parts if first else parts * factors
        constants = library.tensordot(mirror, parts[:, :1], axes=1)
        parts = library.concatenate([constants, parts[:, 1:]], axis=1)
        return parts / factors if first else parts


@final
@dataclass(frozen=True, eq=False)
class PiecewiseBasis(AbstractBasis):
    """The orthonormal polynomials of cells that fill a germ's probability space.

    - `cells`; `pieces`: the polynomials in each, of the same degrees;
    - `indices`: those of the cells' terms, cell after cell.
    """

    germs: Mapping[str, AbstractGerm]
    cells: tuple[Cell, ...]
    pieces: tuple[AbstractBasis, ...]

    @cached_property
    def indices(self) -> Int[np.ndarray, "terms variables"]:  # type: ignore[override]
        """The degree of each variable in each term."""
        return np.tile(self.pieces[0].indices, (len(self.cells), 1))

    @property
    def probability(self) -> Float[np.ndarray, " elements"]:
        """The probability of each element."""
        return np.array([cell.probability for cell in self.cells])

    @cached_property
    def division(self) -> Division:
        """From coefficients to those of the elements."""
        roots = np.sqrt(self.probability)
        away = np.eye(len(roots))[0] - roots
        mirror = np.eye(len(roots)) - np.outer(away, away) * (2 / max(away @ away, np.finfo(float).tiny))
        return Division(jax_array(mirror), jax_array(roots))

    @override
    def matrix(self, points: Float[np.ndarray, "n variables"]) -> Float[np.ndarray, "n terms"]:
        self.refuse_beyond_memory(len(points), 2)
        terms = np.zeros((len(self.cells), self.pieces[0].terms, len(points)))
        for k, (piece, inside) in enumerate(zip(self.pieces, self._inside(points), strict=True)):
            terms[k][:, inside] = piece.matrix(points[inside]).T
        return self._rows(terms)

    def _rows(self, terms: Float[np.ndarray, "elements terms n"]) -> Float[np.ndarray, "n all_terms"]:
        return np.asarray(self.division.whole(jax_array(terms / self.probability[:, None, None]))).T

    @override
    def values(
        self, points: Float[np.ndarray, "n variables"], coefficients: Float[Array, "terms *shape"]
    ) -> Float[Array, "n *shape"]:
        library, parts = in_library(self.division.elements(coefficients))
        inside = self._inside(points)
        each = zip(self.pieces, inside, parts, strict=True)
        values = [library.tensordot(piece.matrix(points[some]), own, axes=1) for piece, some, own in each]
        order = np.argsort(np.concatenate(inside), kind="stable")
        return jax_array(library.concatenate(values)[order])

    def _inside(self, points: Float[np.ndarray, "n variables"]) -> list[Int[np.ndarray, " some"]]:
        """The points of each element."""
        each = zip(self.germs.values(), points.T, strict=True)
        levels = np.stack([germ.cumulative(values) for germ, values in each], axis=1)
        return [np.flatnonzero(cell.holds(levels)) for cell in self.cells]

    def joined(self, collocations: Sequence[Collocation]) -> Collocation:
        """The collocation of all elements as one: each has points and a small matrix of its own."""
        counts = np.cumsum([0, *(len(one.points) for one in collocations)])
        matrix, inverse = np.zeros((2, len(self.cells), self.pieces[0].terms, counts[-1]))
        for k, one in enumerate(collocations):
            own = slice(counts[k], counts[k + 1])
            matrix[k][:, own], inverse[k][:, own] = np.asarray(one.matrix).T, np.asarray(one.pseudo_inverse)
        weights = [chance * np.asarray(one.weights) for chance, one in zip(self.probability, collocations, strict=True)]
        return Collocation(
            points=jax_array(np.concatenate([one.points for one in collocations])),
            weights=jax_array(np.concatenate(weights)),
            matrix=jax_array(self._rows(matrix)),
            pseudo_inverse=self.division.whole(jax_array(inverse)),
            leverage=jax_array(np.concatenate([one.leverage for one in collocations])),
            condition_number=jax_array(max(float(one.condition_number) for one in collocations)),
        )


@final
class InElements(NamedTuple):
    """What a statistic needs of each element, stacked: the `each` of their preparation, and their `division`."""

    division: Division
    each: Pytree


def in_each(preparation: Callable[[AbstractBasis], Pytree], basis: PiecewiseBasis) -> InElements:
    """The preparation of a statistic for each element."""
    return InElements(
        basis.division, jax.tree.map(lambda *each: jax_array(np.stack(each)), *map(preparation, basis.pieces))
    )
