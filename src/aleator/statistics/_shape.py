"""The shape of an output's distribution, from the third and fourth power of its expansion: exact, without sampling.

Products of two basis polynomials are sums of basis polynomials. Univariate products `p_i p_j = sum_k t[i, j, k] p_k`
end at the degree `k = i + j`, with coefficients by Gauss quadrature. The coefficients of multivariate products are
products of these, and few are not zero.
"""

from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy.special import ndtri
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library, jax_array, quietly
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, Division, GaussPoints, PiecewiseBasis
from aleator.statistics._statistic import AbstractStatistic, Mean, Std, in_blocks, level_given, varies
from aleator.uncertainty import AbstractGerm

# So many outputs at once at most, and products of their coefficients: 32 MB.
_TOGETHER, _PRODUCTS = 64, 2**22

# With more products, the constants take gigabytes and an evaluation more than a second.
_MOST_PRODUCTS = 20_000_000

# Triple products below this part of the largest are zero up to rounding.
_ROUNDING = 1e-13


@final
class Square(Module):
    """The contribution of each pair of terms to a term of the square: `square[k] += value * c[i] * c[j]`.

    - `first`, `second`, `target`: `i <= j` and `k`, sorted by `k`. The terms of the square begin with those of the
      expansion itself, in their order; `values` of pairs `i < j` count both orders;
    - `terms`: the number of terms of the square.
    """

    first: Int[Array, " products"]
    second: Int[Array, " products"]
    target: Int[Array, " products"]
    values: Float[Array, " products"]
    terms: int = eqx.field(static=True)

    def of(self, coefficients: Float[Any, "terms n"]) -> Float[Any, "square_terms n"]:
        """The coefficients of the squares of expansions."""
        pairs = self.first, self.second, self.target, self.values
        library, coefficients, (first, second, target, values) = in_library(coefficients, pairs)
        products = values[:, None] * coefficients[first] * coefficients[second]
        if library is np:
            return np.add.reduceat(products, np.searchsorted(target, np.arange(self.terms)))
        return jax.ops.segment_sum(products, target, self.terms, indices_are_sorted=True)

    def moments(self, coefficients: Float[Any, "terms n"]) -> tuple[Float[Any, " n"], Float[Any, " n"]]:
        """`E[y^3]` and `E[y^4]` of outputs: with the expansion of `y^2` sums as in equation (33)."""
        squared = self.of(coefficients)
        return (squared[: len(coefficients)] * coefficients).sum(axis=0), (squared**2).sum(axis=0)


@final
class PowersInElements(Module):
    """The polynomials of each element at Gauss nodes that integrate fourth powers of its expansion exactly.

    - `weights`: of the nodes, adding up to one over all elements.
    """

    division: Division
    matrices: Float[Array, "elements nodes terms"]
    weights: Float[Array, "elements nodes"]

    def moments(self, coefficients: Float[Any, "terms n"]) -> tuple[Float[Any, " n"], Float[Any, " n"]]:
        """`E[y^3]` and `E[y^4]` of outputs."""
        parts = self.matrices, self.division.elements(coefficients), self.weights[..., None]
        library, matrices, elements, weights = in_library(*parts)
        values = library.einsum("ent,eti->eni", matrices, elements)
        return (weights * values**3).sum(axis=(0, 1)), (weights * values**4).sum(axis=(0, 1))


Powers: TypeAlias = Square | PowersInElements


def powers(basis: AbstractBasis) -> Powers:
    """Preparation: what third and fourth powers of an expansion in this basis need.

    Raises `ProblemError` if its square has too many products for memory.
    """
    if not isinstance(basis, PiecewiseBasis):
        return square(basis)
    nodes = [GaussPoints(2 * max(one.degrees) + 1).nodes(one, 0) for one in basis.pieces]
    pairs = list(zip(basis.pieces, nodes, strict=True))
    weights = basis.probability[:, None] * np.stack([own.weights for own in nodes])
    return PowersInElements(
        basis.division, jax_array(np.stack([one.matrix(own.points) for one, own in pairs])), jax_array(weights)
    )


def square(basis: AbstractBasis) -> Square:
    """The square of an expansion in this basis. Raises `ProblemError` if it has too many products for memory."""
    first, second = np.triu_indices(basis.terms)
    values = np.where(first == second, 1.0, 2.0)
    # The term of the square that a product belongs to, as far as it is determined by the variables so far.
    target = np.zeros(first.size, dtype=np.int64)
    for degrees, degree, germ in zip(basis.indices.T, basis.degrees, basis.germs.values(), strict=True):
        factors = _triple_products(germ, degree)
        pair, power = _nonzero(factors, degrees[first], degrees[second])
        if pair.size > _MOST_PRODUCTS:
            raise ProblemError(
                f"Skewness and kurtosis: the square of an expansion of {basis.terms} terms in {basis.variables} "
                f"variables has more than {_MOST_PRODUCTS} products. Use a lower order or a sparser index set, or take "
                "quantiles, which need no square."
            )
        first, second = first[pair], second[pair]
        values = values[pair] * factors[degrees[first], degrees[second], power]
        _, target = np.unique(target[pair] * (2 * degree + 1) + power, return_inverse=True)
    return _sorted(first, second, target, values)


def _triple_products(germ: AbstractGerm, degree: int) -> Float[np.ndarray, "degrees degrees doubled"]:
    """The expected values of `p_i p_j p_k`, for `i` and `j` up to the degree and `k` up to twice the degree."""
    nodes, weights = germ.gauss(2 * degree + 1)
    # Of data, all polynomials are those of lower degrees than there are distinct values.
    polynomials = germ.polynomials(min(2 * degree, len(nodes) - 1), nodes)
    lower = polynomials[:, : degree + 1]
    triples = np.einsum("n,ni,nj,nk->ijk", weights, lower, lower, polynomials)
    i, j, k = np.indices(triples.shape)
    possible = (k <= i + j) & (k >= abs(i - j))
    return np.where(possible & (np.abs(triples) > _ROUNDING * np.abs(triples).max()), triples, 0.0)


def _nonzero(
    factors: Float[np.ndarray, "degrees degrees doubled"], i: Int[np.ndarray, " n"], j: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """For pairs of degrees `i[n]`, `j[n]` all `k` with a nonzero factor: `n` and `k` of each."""
    powers = np.nonzero(factors)[2]
    counts = np.count_nonzero(factors, axis=2)
    starts = np.cumsum(counts.ravel()).reshape(counts.shape) - counts
    count = counts[i, j]
    pair = np.repeat(np.arange(i.size), count)
    within = np.arange(pair.size) - np.repeat(np.cumsum(count) - count, count)
    return pair, powers[starts[i, j][pair] + within]


def _sorted(first: np.ndarray, second: np.ndarray, target: np.ndarray, values: np.ndarray) -> Square:
    """Number the terms of the square: first those of the expansion, which are the products with the constant."""
    count = int(target.max()) + 1
    own = target[first == 0][np.argsort(second[first == 0])]
    number = np.empty(count, dtype=np.int64)
    number[np.concatenate([own, np.setdiff1d(np.arange(count), own)])] = np.arange(count)
    target = number[target]
    order = np.argsort(target, kind="stable")
    columns = (jax_array(column[order]) for column in (first, second, target, values))
    return Square(*columns, terms=count)


class AbstractOfPowers(AbstractStatistic):
    """A statistic by third and fourth powers of an expansion."""

    needs_no_compiler: ClassVar[bool] = True

    @property
    @override
    def preparation(self) -> Callable[..., Powers]:
        return powers


@final
class Skewness(AbstractOfPowers):
    """The skewness `E[(y - mean)^3] / std^3`: zero for a normal distribution, and where the output does not vary."""

    symbol: ClassVar[str] = "Skew"
    dimensionless: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Powers) -> Float[Array, "*shape"]:
        return jax_array(shape_of(coefficients, constants)[0])

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return _power_mean(values, 3)


@final
class Kurtosis(AbstractOfPowers):
    """The kurtosis `E[(y - mean)^4] / std^4`, not the excess: 3 for a normal distribution, zero if nothing varies."""

    symbol: ClassVar[str] = "Kurt"
    dimensionless: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Powers) -> Float[Array, "*shape"]:
        return jax_array(shape_of(coefficients, constants)[1])

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return _power_mean(values, 4)


@final
class CornishFisher(AbstractOfPowers):
    """An approximate quantile from the first four moments: smooth, cheap, and accurate if nearly normal.

    Source: Cornish and Fisher (1938), Moments and cumulants in the specification of distributions.
    """

    level: Scalar

    speaks_of_one_system: ClassVar[bool] = True

    def __init__(self, level: Scalar):
        self.level = level_given("CornishFisher", level)

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Powers) -> Float[Array, "*shape"]:
        skewness, kurtosis = shape_of(coefficients, constants)
        return self.of_moments(Mean().of(coefficients, ()), Std().of(coefficients, ()), skewness, kurtosis)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        kinds = (Mean(), Std(), Skewness(), Kurtosis())
        return self.of_moments(*(kind.of_sample(values) for kind in kinds))

    def of_moments(self, mean: Array, std: Array, skewness: Array, kurtosis: Array) -> Float[Array, "*shape"]:
        """The quantile of a distribution with these moments."""
        library, z, mean, std, skewness, kurtosis = in_library(self.level, mean, std, skewness, kurtosis)
        z = scipy.special.ndtri(z) if library is np else ndtri(jnp.asarray(z, dtype=float))
        normal = z + (z**2 - 1) * skewness / 6 + (z**3 - 3 * z) * (kurtosis - 3) / 24
        return jax_array(mean + std * (normal - (2 * z**3 - 5 * z) * skewness**2 / 36))

    @override
    def text(self, inside: str) -> str:
        return f"CF{float(self.level):g}[{inside}]"


@quietly
def shape_of(
    coefficients: Float[Any, "terms *shape"], constants: Powers
) -> tuple[Float[Any, "*shape"], Float[Any, "*shape"]]:
    """Skewness and kurtosis."""

    def both(entries: Float[Any, "entries terms"]) -> Float[Any, "entries 2"]:
        _, spreads, std = in_library(varies(entries.T), Std().of(entries.T, ()))
        centred = library.where(library.arange(entries.shape[1])[None] > 0, entries, 0.0).T
        standard = library.where(spreads[None], centred / library.where(spreads, std, 1.0)[None], 0.0)
        return library.stack(constants.moments(standard), axis=-1)

    library, coefficients, constants = in_library(coefficients, constants)
    products = max(one.size for one in jax.tree.leaves(constants))
    moments = in_blocks(both, coefficients, max(1, min(_TOGETHER, _PRODUCTS // products)))
    return moments[..., 0], moments[..., 1]


@quietly
def _power_mean(values: Float[Array, "samples *shape"], power: int) -> Float[Array, "*shape"]:
    """The mean power of a sample that is shifted and scaled to mean zero and (biased) variance one."""
    library, values = in_library(values)
    away = values - library.mean(values, axis=0)[None]
    square_mean = library.mean(away**2, axis=0)
    standard = away / library.sqrt(library.where(square_mean > 0, square_mean, 1.0))[None]
    return jax_array(library.mean(standard**power, axis=0))
