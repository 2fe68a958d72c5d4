"""Points for a basis: distributed by its Christoffel function, evenly or at random, or selected by the determinant."""

from collections.abc import Mapping
from typing import final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.expansion._basis import Basis
from aleator.expansion._points import AbstractCountedPoints, AbstractPoints, HammersleyPoints, Nodes, seed_given
from aleator.uncertainty import AbstractGerm

# Candidates per selected point.
_CANDIDATES = 10

# Roots of a rule beyond twice the degree, so that a distribution is nearly uniform between two of them.
_FINE = 60


@final
class InducedPoints(AbstractCountedPoints):
    """Hammersley points mapped by the quantiles of the densities `Psi_j^2 f` of the terms in turn, weighted by `1 / K`.

    `count`: by default as many points as the fit needs, for least squares three per term.
    They have the density of `ChristoffelPoints`, but are even and not random, and cover the tails of unbounded
    distributions, where polynomials are large. Quantiles of evenly spread levels do not reach into the tails, so that a
    polynomial fitted to them extrapolates there unchecked. Source: Cohen and Migliorati (2017), Optimal weighted
    least-squares methods; Narayan (2018), Computation of induced orthogonal polynomial distributions.
    """

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        count = self.count or usual
        levels = HammersleyPoints().levels(count, basis.variables)
        return _weighted(basis, np.arange(count) % basis.terms, levels)


@final
class UsualPoints(AbstractCountedPoints):
    """The default: `HammersleyPoints` if every germ is bounded, otherwise `InducedPoints`."""

    @override
    def of(self, germs: Mapping[str, AbstractGerm]) -> AbstractPoints:
        bounded = all(np.all(np.isfinite(germ.support())) for germ in germs.values())
        return HammersleyPoints(self.count) if bounded else InducedPoints(self.count)

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
    weights of the points correct this small error.
    """
    roots = _roots(germ, highest)
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
    return values


def _roots(germ: AbstractGerm, highest: int) -> Float[np.ndarray, " roots"]:
    """The roots of a fine Gauss rule, or of one that just suffices if a data sample allows no finer."""
    try:
        return germ.gauss(2 * highest + _FINE)[0]
    except ProblemError:
        return germ.gauss(max(highest, 1) + 1)[0]
