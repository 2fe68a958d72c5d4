"""`ElementExpanded`: a piecewise expansion with its statistics.

Sobol indices are exact parts of the variance of a piecewise polynomial. Given some of the variables, the conditional
mean of the output is a piecewise polynomial of these: in each element the terms that depend on no others, weighted by
the probability of the element's extent in the other variables. Its variance is a sum over all pairs of elements of
integrals over the intersection of their cells, which factor by variable and are exact by Gauss quadrature. Definitions:
Sobol (2001), Global sensitivity indices for nonlinear mathematical models.

Quantiles and probabilities are those of a large sample: values by counting, derivatives by a kernel. The proportion of
a sample beyond a threshold is a step function of its values, whose derivative is useless. The mean of normal
distribution functions centred at the values has the right derivative, if their width vanishes slowly with the sample's
size.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from typing import NamedTuple, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jax.scipy.stats import norm
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.arrays import NUMBER, Pytree, Scalar, in_library, jax_array, refuse_beyond_memory
from aleator._core.compilation import evaluate
from aleator._core.leaves import is_traced
from aleator.analysis._abstract_expanded import (
    AbstractExpanded,
    as_lines,
    checked_points,
    distribution_rows,
    nothing,
    output_rows,
    paired,
    prepared,
)
from aleator.analysis._elements import Partition, restricted, warn_of_few_points
from aleator.ensemble import inputs_at, part
from aleator.expansion import Basis
from aleator.statistics import (
    AbstractStatistic,
    AbstractTail,
    Covariance,
    Infimum,
    Kurtosis,
    Mean,
    Probability,
    Quantile,
    Skewness,
    Sobol,
    Std,
    Supremum,
    TotalSobol,
    Variance,
    refuse_correlated,
    varies,
)
from aleator.statistics._sobol import place_of
from aleator.statistics._statistic import root
from aleator.uncertainty import AbstractDistribution, AbstractGerm, Placements

Rule: TypeAlias = Callable[[Float[Array, "elements terms *shape"]], Float[Array, "*shape"]]
"""Gives a part of the variance from the coefficients in all elements, with the overall mean subtracted."""

# For memory: the product of the variables' contributions to pairs of terms, and one factor of it.
_MATRICES = 2


@final
class ElementExpanded(AbstractExpanded):
    """Outputs as polynomials of the germ in each element of its domain; `print(expanded)` shows a summary.

    - `distributions`: that of each uncertain input, by name; `partition`: the elements, with the polynomials in each;
    - `coefficients`: of each output, shape (elements, terms, *shape);
    - `splits`: the variable of each split, in order; `calls`: how often the function was called;
    - `error`: estimated relative rms error of the piecewise expansion, the largest over the outputs.

    Moments are sums over the elements, Sobol indices sums over pairs of elements, extremes the most extreme over the
    elements. All other statistics are those of a low-discrepancy sample of the piecewise expansion, of 16 384 points;
    derivatives of probabilities and quantiles are kernel estimates, accurate to about a percent.
    """

    distributions: dict[str, AbstractDistribution]
    partition: Partition = eqx.field(static=True)
    coefficients: Pytree
    splits: tuple[str, ...] = eqx.field(static=True)
    calls: int = eqx.field(static=True)
    error: float = eqx.field(static=True)

    @override
    def __getitem__(self, name: str) -> "ElementExpanded":
        output = part(self.coefficients, name)
        return ElementExpanded(self.distributions, self.partition, output, self.splits, self.calls, self.error)

    def _both(self, first: str, second: str) -> "ElementExpanded":
        both = paired(self.coefficients, first, second)
        return ElementExpanded(self.distributions, self.partition, both, self.splits, self.calls, self.error)

    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """Raises `ProblemError` for Sobol indices of correlated inputs."""
        refuse_correlated(self.distributions, kind)
        rule = self._rule(kind, differentiated := is_traced((kind, self.coefficients)))
        values = jax.tree.map(jax.jit(rule) if differentiated else rule, self.coefficients)
        if isinstance(kind, AbstractTail):
            warn_of_few_points(kind, jax.tree.leaves(values))
        return values

    def _rule(self, kind: AbstractStatistic, differentiated: bool) -> Callable[[Array], Array]:
        """The function that computes a statistic from the coefficients in all elements."""
        if isinstance(kind, Mean):
            return self._mean
        if isinstance(kind, Variance):
            return self._variance
        if isinstance(kind, Std):
            return self._std
        if isinstance(kind, Skewness):
            return lambda coefficients: self._standard_moment(coefficients, 3)
        if isinstance(kind, Kurtosis):
            return lambda coefficients: self._standard_moment(coefficients, 4)
        if isinstance(kind, Covariance):
            return self._covariance
        if isinstance(kind, Sobol | TotalSobol):
            return partial(self._share, of_part=variance_part(self.partition, kind))
        if isinstance(kind, Supremum):
            return lambda coefficients: jnp.max(self._in_each(kind, coefficients), axis=0)
        if isinstance(kind, Infimum):
            return lambda coefficients: jnp.min(self._in_each(kind, coefficients), axis=0)
        if isinstance(kind, Probability) and differentiated:
            return lambda coefficients: _probability(kind, self._sample(coefficients))
        if isinstance(kind, Quantile) and differentiated:
            return lambda coefficients: _quantile(kind, self._sample(coefficients))
        return lambda coefficients: kind.of_sample(self._sample(coefficients))

    @override
    def cdf(self, values: Float[Array, " n"]) -> Pytree:
        return self._at_each(_cdf, values)

    @override
    def pdf(self, values: Float[Array, " n"]) -> Pytree:
        """By a kernel estimate."""
        return self._at_each(_pdf, values)

    def _at_each(self, function: Callable[[Array, Array], Array], values: Float[Array, " n"]) -> Pytree:
        def of(coefficients: Array) -> Array:
            return evaluate(each, self._sample(coefficients), jnp.asarray(values, dtype=float))

        def each(sample: Array, values: Array) -> Array:
            return jax.lax.map(lambda value: function(sample, value), values)

        return jax.tree.map(of, self.coefficients)

    def _in_each(
        self, kind: AbstractStatistic, coefficients: Float[Array, "elements terms *shape"]
    ) -> Float[Array, "elements *shape"]:
        """A statistic of the expansion in each element."""
        values = [
            evaluate(kind.of, terms, prepared(kind.preparation, basis))
            for terms, basis in zip(coefficients, self.partition.bases, strict=True)
        ]
        return jnp.stack(values)

    def _sample(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "samples *shape"]:
        """A low-discrepancy sample of the piecewise expansion."""
        return self.partition.cloud.evaluate(coefficients)

    def _mean(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
        library, terms = in_library(coefficients)
        return jax_array(library.tensordot(self.partition.probability, terms[:, 0], axes=1))

    def _variance(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
        library, terms, mean = in_library(coefficients, self._mean(coefficients))
        away = terms[:, 0] - mean[None]
        within = library.sum(terms[:, 1:] ** 2, axis=1)
        return jax_array(library.tensordot(self.partition.probability, within + away**2, axes=1))

    def _std(self, coefficients: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
        return root(self._variance(coefficients))

    def _share(self, coefficients: Float[Array, "elements terms *shape"], of_part: Rule) -> Float[Array, "*shape"]:
        """A part of the variance over all of it; zero, with derivative zero, if the variance is zero."""
        mean, variance = self._mean(coefficients), self._variance(coefficients)
        library, away, mean, variance = in_library(coefficients, mean, variance)
        spreads = library.asarray(varies(library.stack([mean, root(variance)])))
        away = library.concatenate([away[:, :1] - mean[None, None], away[:, 1:]], axis=1)
        share = library.asarray(of_part(away)) / library.where(spreads, variance, 1.0)
        return jax_array(library.where(spreads, library.clip(share, 0.0, 1.0), 0.0))

    def _covariance(self, coefficients: Float[Array, "elements terms *shape 2"]) -> Float[Array, "*shape"]:
        library, terms, mean = in_library(coefficients, self._mean(coefficients))
        away = terms[:, 0] - mean[None]
        within = library.sum(library.prod(terms[:, 1:], axis=-1), axis=1)
        return jax_array(library.tensordot(self.partition.probability, within + library.prod(away, axis=-1), axes=1))

    def _standard_moment(
        self, coefficients: Float[Array, "elements terms *shape"], power: int
    ) -> Float[Array, "*shape"]:
        """The mean of a power of the standardised output, by quadrature in each element; zero if nothing varies."""
        library, elements, mean, std = in_library(coefficients, self._mean(coefficients), self._std(coefficients))
        scale = library.where(std > 0, std, 1.0)[None]
        moments = [
            library.tensordot(
                weights, ((library.tensordot(matrix, terms, axes=1) - mean[None]) / scale) ** power, axes=1
            )
            for terms, (matrix, weights) in zip(elements, self.partition.quadrature, strict=True)
        ]
        return jax_array(library.tensordot(self.partition.probability, library.stack(moments), axes=1))

    @override
    def at_germ(self, points: Float[np.ndarray, "n variables"]) -> Pytree:
        scattered = self.partition.scatter(checked_points(points, self.germs))
        return jax.tree.map(scattered.evaluate, self.coefficients)

    @property
    @override
    def germs(self) -> Mapping[str, AbstractGerm]:
        return self.partition.germs

    def __str__(self) -> str:
        count, basis = len(self.partition.cells), self.partition.bases[0]
        how = f"{count} element{'s' * (count != 1)} of order {basis.order}, {self.calls} calls"
        rows = [
            ("expansion", how),
            ("split", self._split_text()),
            ("error", f"{self.error:.1e} of the standard deviation, estimated by leaving one sample out"),
        ]
        remarks = jax.tree.map(lambda _: nothing, self.coefficients)
        return as_lines([*rows, *distribution_rows(self.distributions), *output_rows(self.mean, self.std, remarks)])

    def _split_text(self) -> str:
        """How often each variable was split, and where the smallest element lies."""
        if not self.splits:
            return "nothing: one element is enough"
        times = ", ".join(f"{name} {count} times" for name, count in Counter(self.splits).most_common())
        smallest = min(range(len(self.partition.cells)), key=lambda k: self.partition.cells[k].probability)
        cell, germs = self.partition.cells[smallest], self.partition.bases[smallest].germs
        ends = np.array([germ.support() for germ in germs.values()]).T
        places = Placements(dict(self.distributions), {})
        low, high = (inputs_at(places, end, jnp.zeros(0)) for end in ends)
        where = ", ".join(f"{name} from {low[name]:.6g} to {high[name]:.6g}" for name in self.distributions)
        return f"{times}; the smallest element: {where}, probability {cell.probability:.2g}"


def variance_part(partition: Partition, kind: Sobol | TotalSobol) -> Rule:
    """The part of the variance whose share is a Sobol index.

    Raises `ProblemError` for an unknown variable, and if all pairs of elements would not fit into memory.
    """
    whole = Basis(partition.germs, partition.bases[0].indices)
    if isinstance(kind, TotalSobol):
        place = place_of(whole, kind.variable)
        others = _explained(partition, tuple(i for i in range(whole.variables) if i != place))
        everything = partition.probability

        def part(terms: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
            library, known = in_library(terms)
            return jax_array(library.tensordot(everything, library.sum(known**2, axis=1), axes=1)) - others(terms)

        return part
    places = sorted(place_of(whole, name) for name in kind.variables)
    signed = [
        ((-1) ** (len(places) - size), _explained(partition, known))
        for size in range(1, len(places) + 1)
        for known in combinations(places, size)
    ]
    return lambda terms: jnp.asarray(sum(sign * explained(terms) for sign, explained in signed))


def _explained(partition: Partition, known: tuple[int, ...]) -> Rule:
    """The variance of the mean given the known variables: a quadratic form in the terms that depend on these alone."""
    indices = partition.bases[0].indices
    unknown = [i for i in range(indices.shape[1]) if i not in known]
    chosen = np.flatnonzero((indices[:, unknown] == 0).all(axis=1))
    degrees = indices[chosen]
    size = len(partition.cells) * len(chosen)
    refuse_beyond_memory(
        f"Sobol index: all pairs of {len(chosen)} terms in {len(partition.cells)} elements",
        NUMBER * _MATRICES * size**2,
        "Lower the budget of al.MultiElement, or take al.references.sobol_indices.",
    )
    cuts = [_cuts(partition, i) for i in range(indices.shape[1])]
    weights = np.prod([cuts[i].widths[cuts[i].owner] for i in unknown], axis=0) * np.ones(len(partition.cells))
    rows = np.repeat(weights, len(chosen))
    form = rows[:, None] * rows[None]
    for i in known:
        gram = _gram(partition, i, cuts[i], int(degrees[:, i].max()))
        of_rows = np.repeat(cuts[i].owner, len(chosen)), np.tile(degrees[:, i], len(partition.cells))
        form *= gram[of_rows[0][:, None], of_rows[0][None], of_rows[1][:, None], of_rows[1][None]]

    def variance(terms: Float[Array, "elements terms *shape"]) -> Float[Array, "*shape"]:
        library, terms = in_library(terms)
        own = terms[:, chosen].reshape(size, *terms.shape[2:])
        return jax_array(library.sum(own * library.tensordot(form, own, axes=1), axis=0))

    return variance


class _Cuts(NamedTuple):
    """The intervals of probability levels into which one variable is cut.

    - `ends`: of each distinct interval; `owner`: the interval of each element.
    """

    ends: Float[np.ndarray, "intervals 2"]
    owner: Int[np.ndarray, " elements"]

    @property
    def widths(self) -> Float[np.ndarray, " intervals"]:
        """The probability of each interval."""
        return self.ends[:, 1] - self.ends[:, 0]


def _cuts(partition: Partition, variable: int) -> _Cuts:
    ends = np.array([(cell.low[variable], cell.high[variable]) for cell in partition.cells])
    different, owner = np.unique(ends, axis=0, return_inverse=True)
    return _Cuts(different, owner.ravel())


def _gram(
    partition: Partition, variable: int, cuts: _Cuts, degree: int
) -> Float[np.ndarray, "intervals intervals degrees degrees"]:
    """`E[1 p_a 1' p_b']` for the polynomials of any two intervals, each zero outside its own."""
    germ = list(partition.germs.values())[variable]
    distributions = [restricted(germ, *map(float, ends)) for ends in cuts.ends]
    count = len(distributions)
    gram = np.zeros((count, count, degree + 1, degree + 1))
    for i, j in combinations(range(count), 2):
        low, high = max(cuts.ends[i, 0], cuts.ends[j, 0]), min(cuts.ends[i, 1], cuts.ends[j, 1])
        if low < high:
            nodes, weights = restricted(germ, float(low), float(high)).gauss(degree + 1)
            first, second = (
                distribution.polynomials(degree, nodes) for distribution in (distributions[i], distributions[j])
            )
            gram[i, j] = (high - low) * (first * weights[:, None]).T @ second
            gram[j, i] = gram[i, j].T
    for i, width in enumerate(cuts.widths):
        gram[i, i] = width * np.eye(degree + 1)
    return gram


def _probability(kind: Probability, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The proportion of the sample between the thresholds of `kind`."""
    upper = 1.0 if kind.below is None else _smooth_below(values, kind.below)
    lower = 0.0 if kind.above is None else _smooth_below(values, kind.above)
    return jax.lax.stop_gradient(kind.of_sample(values)) + _only_derivative(jnp.asarray(upper - lower))


def _quantile(kind: Quantile, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The quantile of the sample, differentiated by the implicit function theorem."""
    value = jax.lax.stop_gradient(kind.of_sample(values))
    density = jax.lax.stop_gradient(_pdf(values, value))
    regular = density > 0
    excess = _only_derivative(_smooth_below(values, value) - kind.level)
    return value - jnp.where(regular, excess / jnp.where(regular, density, 1.0), 0.0)


def _cdf(values: Float[Array, "samples *shape"], threshold: Scalar) -> Float[Array, "*shape"]:
    """The proportion of the sample below a threshold."""
    return _probability(Probability(below=threshold), values)


def _pdf(values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The density at a threshold, by the kernel estimate."""
    width = _width(values)
    return jnp.mean(norm.pdf((_levels(values, threshold) - values) / width[None]), axis=0) / width


def _smooth_below(
    values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    return jnp.mean(ndtr((_levels(values, threshold) - values) / _width(values)[None]), axis=0)


def _levels(
    values: Float[Array, "samples *shape"], threshold: Scalar | Float[Array, "*shape"]
) -> Float[Array, "1 *shape"]:
    return jnp.broadcast_to(jnp.asarray(threshold, dtype=float), values.shape[1:])[None]


def _width(values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
    """The width of the kernel: small compared with the spread of the sample, large compared with its gaps."""
    std = jax.lax.stop_gradient(jnp.std(values, axis=0))
    return jnp.where(std > 0, std, 1.0) * len(values) ** (-1 / 3)


def _only_derivative(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Zero, with the derivative of `value`."""
    return value - jax.lax.stop_gradient(value)
