"""Point sets: where in germ space a model is evaluated.

They cover it evenly, or follow a basis: distributed by its Christoffel function, or selected by the determinant.
"""

import abc
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core import border
from aleator._core.leaves import Module
from aleator.expansion._basis import Basis
from aleator.uncertainty import AbstractGerm, SampleGerm

_SOBOL_BITS = 30

# Candidates per selected point.
_CANDIDATES = 10

# Most variables of Hammersley points by default: the columns of two large prime bases depend on each other until there
# are about as many points as their product, and 165 points in nine variables have a singular matrix of order 2.
_FEW_VARIABLES = 8

# Roots of a rule beyond twice the degree, so that a distribution is nearly uniform between two of them.
_FINE = 60


class Nodes(NamedTuple):
    """Collocation points with weights that add up to one, equal unless the set says otherwise.

    - `points`: germ values, shape (n_cp, variables);
    - `weights`: shape (n_cp,), of the squares in least squares and in the leave-one-out error.
    """

    points: Float[np.ndarray, "points variables"]
    weights: Float[np.ndarray, " points"]


def count_given(count: int | None) -> int | None:
    """A checked number of points or roots; None if it follows from the basis."""
    return None if count is None else border.whole("The number of points", count)


def seed_given(seed: int) -> int:
    """A checked seed of random numbers."""
    return border.whole("The seed of random points", seed, least=0)


class AbstractPoints(Module):
    """How collocation points are chosen for a basis.

    `nested`: whether a larger set contains the points of every smaller one, as growing an index set needs.
    """

    nested: ClassVar[bool] = False

    @abc.abstractmethod
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        """The points and their weights; `usual` is the number of points for sets that were given none."""

    def of(self, germs: Mapping[str, AbstractGerm]) -> "AbstractPoints":
        """The point set to use for a germ: itself, unless it chooses by the germ."""
        del germs
        return self


class AbstractCountedPoints(AbstractPoints):
    """A point set of any size: by default as many points as the fit needs, for least squares three per term."""

    count: int | None = eqx.field(static=True, default=None, converter=count_given)


class AbstractEvenPoints(AbstractCountedPoints):
    """Points that cover the unit cube evenly, mapped to the germ by its quantile functions; equal weights."""

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        count = self.count or usual
        return Nodes(basis.map_to_germ(self.levels(count, basis.variables)), np.full(count, 1 / count))

    @abc.abstractmethod
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        """`count` points in the open unit cube."""


@final
class HammersleyPoints(AbstractEvenPoints):
    """The Hammersley set: `(i - 1/2)/count` and the radical inverses of `i = 1 .. count` in the prime bases.

    `count`: by default as many points as the fit needs, for least squares three per term.
    The half and the start at 1 keep every coordinate away from 0 and 1, where unbounded distributions are infinite.
    Beyond eight variables its columns may depend on each other, as those of `HaltonPoints`: take `SobolPoints` there.
    Source: Hammersley (1960), Annals of the New York Academy of Sciences 86.
    """

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        index = np.arange(1, count + 1)
        return np.column_stack([(index - 0.5) / count, _halton(index, variables - 1)])[:, :variables]


@final
class HaltonPoints(AbstractEvenPoints):
    """The Halton sequence from `i = 1` on: the radical inverses of `i` in the prime bases. Nested.

    `count`: by default as many points as the fit needs, for least squares three per term.
    Beyond about ten variables its columns are correlated unless there are very many points: take `SobolPoints` there.
    Source: Halton (1960), Numerische Mathematik 2.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return _halton(np.arange(1, count + 1), variables)


class AbstractDrawnPoints(AbstractEvenPoints):
    """Random points in the unit cube, the same ones for the same `seed`."""

    seed: int = eqx.field(static=True, default=0, converter=seed_given)


@final
class SobolPoints(AbstractDrawnPoints):
    """The Sobol sequence with Owen's scrambling. Nested; most even if the count is a power of two.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the scrambling.
    Source: Owen (1998), Scrambling Sobol' and Niederreiter-Xing points; directions by Joe and Kuo (2008), by SciPy.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        engine = scipy.stats.qmc.Sobol(variables, scramble=True, bits=_SOBOL_BITS, rng=np.random.default_rng(self.seed))
        # Shifted by half a step, because 0 is infinite under an unbounded distribution.
        return engine.random_base2(int(count - 1).bit_length())[:count] + 0.5 ** (_SOBOL_BITS + 1)


@final
class LatinHypercubePoints(AbstractDrawnPoints):
    """A Latin hypercube: one random point in each of `count` slices of equal probability of every variable.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    Source: McKay, Beckman and Conover (1979), Technometrics 21; by SciPy.
    """

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return scipy.stats.qmc.LatinHypercube(variables, rng=np.random.default_rng(self.seed)).random(count)


@final
class RandomPoints(AbstractDrawnPoints):
    """Independent random points, as in Monte Carlo. Nested.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return np.random.default_rng(self.seed).random((count, variables))


def _even(variables: int, count: int | None = None) -> AbstractEvenPoints:
    return HammersleyPoints(count) if variables <= _FEW_VARIABLES else SobolPoints(count)


def _halton(index: np.ndarray, variables: int) -> Float[np.ndarray, "count variables"]:
    columns = [radical_inverse(index, base) for base in _primes(variables)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(index), 0))


def radical_inverse(index: np.ndarray, base: int) -> Float[np.ndarray, " count"]:
    """The digits of each index in `base`, mirrored at the radix point (van der Corput)."""
    remaining, factor = index.copy(), 1.0 / base
    value = np.zeros(index.shape)
    while remaining.any():
        remaining, digit = np.divmod(remaining, base)
        value += factor * digit
        factor /= base
    return value


def _primes(count: int) -> list[int]:
    primes: list[int] = []
    candidate = 2
    while len(primes) < count:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes


@final
class InducedPoints(AbstractCountedPoints):
    """Even points mapped by the quantiles of the densities `Psi_j^2 f` of the terms in turn, weighted by `1 / K`.

    `count`: by default as many points as the fit needs, for least squares three per term. Even points are those of
    Hammersley or, in more than eight variables, of Sobol.
    They have the density of `ChristoffelPoints`, but are even and not random, and cover the tails of unbounded
    distributions, where polynomials are large. Quantiles of evenly spread levels do not reach into the tails, so that a
    polynomial fitted to them extrapolates there unchecked. Source: Cohen and Migliorati (2017), Optimal weighted
    least-squares methods; Narayan (2018), Computation of induced orthogonal polynomial distributions.
    """

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        count = self.count or usual
        levels = _even(basis.variables).levels(count, basis.variables)
        return _weighted(basis, np.arange(count) % basis.terms, levels)


@final
class UsualPoints(AbstractCountedPoints):
    """The default: even points (`HammersleyPoints` or, in more than eight variables, `SobolPoints`), and with `tails`
    `InducedPoints` if a germ is unbounded.
    """

    tails: bool = eqx.field(static=True, default=True)

    @override
    def of(self, germs: Mapping[str, AbstractGerm]) -> AbstractPoints:
        bounded = all(np.all(np.isfinite(germ.support())) for germ in germs.values())
        return _even(len(germs), self.count) if bounded or not self.tails else InducedPoints(self.count)

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        return self.of(basis.germs).nodes(basis, usual)


class AbstractBasisPoints(AbstractCountedPoints):
    """Weighted points that depend on the polynomials; the same ones for the same `seed`."""

    seed: int = eqx.field(static=True, default=0, converter=seed_given)


@final
class ChristoffelPoints(AbstractBasisPoints):
    """Random points of density `f K / n_b` with the Christoffel function `K = sum of Psi_j^2`, weighted by `1 / K`.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    Where polynomials are large, as in the tails of a normal distribution, there are many points of small weight. So the
    weighted collocation matrix stays well conditioned at any order, unlike that of quantiles of evenly spread levels.
    Each term gets the same number of points. Source: Cohen and Migliorati (2017), Optimal weighted least-squares
    methods.
    """

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        return _drawn(basis, self.count or usual, self.seed)


@final
class OptimalPoints(AbstractBasisPoints):
    """A selection of one in ten Christoffel points, for a large determinant of the weighted collocation matrix.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    A QR factorisation with column pivoting selects as many points as terms; further ones are selected in the same way
    from the rest. Source: Bos, De Marchi, Sommariva and Vianello (2010), Computing multivariate Fekete and Leja points
    by numerical linear algebra; Diaz, Doostan and Hampton (2018) with weights.
    """

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        count = self.count or usual
        points, weights = _drawn(basis, _CANDIDATES * count, self.seed)
        rows = basis.matrix(points) * np.sqrt(weights)[:, None]
        chosen: list[int] = []
        left = np.arange(len(points))
        while len(chosen) < count:
            pivots = scipy.linalg.qr(rows[left].T, mode="r", pivoting=True)[-1]
            best = pivots[: min(basis.terms, count - len(chosen))]
            chosen += left[best].tolist()
            left = np.delete(left, best)
        return Nodes(points[chosen], weights[chosen] / weights[chosen].sum())


def _drawn(basis: Basis, count: int, seed: int) -> Nodes:
    """Points drawn from the mixture of the densities `Psi_j^2 f`, equally many from each up to the remainder."""
    rng = np.random.default_rng(seed)
    terms = rng.permutation(np.arange(count) % basis.terms)
    return _weighted(basis, terms, rng.random((count, basis.variables)))


def _weighted(basis: Basis, terms: np.ndarray, levels: Float[np.ndarray, "n variables"]) -> Nodes:
    """Points at given levels of the densities `Psi_j^2 f` of given terms, weighted by the Christoffel function."""
    columns = [
        _induced(germ, degree, basis.indices[terms, i], levels[:, i])
        for i, (germ, degree) in enumerate(zip(basis.germs.values(), basis.degrees, strict=True))
    ]
    points = np.stack(columns, axis=1)
    weights = 1 / np.sum(basis.matrix(points) ** 2, axis=1)
    return Nodes(points, weights / weights.sum())


def _induced(
    germ: AbstractGerm, highest: int, degrees: np.ndarray, levels: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Quantiles of the densities `p_degree^2 f` of one variable, each at its own degree and level.

    A Gauss rule gives their masses around its roots exactly; within a cell the distribution is taken as uniform. The
    weights of the points correct this small error. Of data, they are the nearest of these.
    """
    roots, _ = germ.gauss(2 * highest + _FINE)  # of data, at most their distinct values
    polynomials = germ.polynomials(len(roots) - 1, roots)
    # Gauss weights by the rule's own Christoffel function: accurate in the tails, where eigenvectors are rounding.
    masses = polynomials[:, : highest + 1] ** 2 / np.sum(polynomials**2, axis=1)[:, None]
    low, high = germ.support()
    gaps = np.diff(roots)
    inner = roots[:-1] + gaps / 2
    edges = np.concatenate([[max(low, roots[0] - gaps[0] / 2)], inner, [min(high, roots[-1] + gaps[-1] / 2)]])
    values = np.empty(len(levels))
    for degree in np.unique(degrees).tolist():
        cumulative = np.append(0.0, np.cumsum(masses[:, degree]))
        mine = degrees == degree
        values[mine] = np.interp(levels[mine] * cumulative[-1], cumulative, edges)
    if isinstance(germ, SampleGerm):
        return germ.values[np.searchsorted((germ.values[1:] + germ.values[:-1]) / 2, values)]
    return values
