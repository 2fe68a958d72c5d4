"""`ElementExpanded`: a piecewise expansion with its statistics."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array
from aleator._core.tracing import evaluate
from aleator.analysis import _sampled_distribution as sampled_distribution
from aleator.analysis._abstract_expanded import AbstractExpanded, checked_points, paired, prepared
from aleator.analysis._element_sobol import Rule, variance_part
from aleator.analysis._expanded_text import as_lines, distribution_rows, nothing, output_rows
from aleator.analysis._partition import Partition
from aleator.ensemble import inputs_at, part
from aleator.statistics import (
    AbstractStatistic,
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
from aleator.statistics._statistic import root
from aleator.uncertainty import AbstractDistribution, AbstractGerm, Placements


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
        one = part(self.coefficients, name)
        return ElementExpanded(self.distributions, self.partition, one, self.splits, self.calls, self.error)

    def _both(self, first: str, second: str) -> "ElementExpanded":
        both = paired(self.coefficients, first, second)
        return ElementExpanded(self.distributions, self.partition, both, self.splits, self.calls, self.error)

    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """Raises `ProblemError` for Sobol indices of correlated inputs."""
        refuse_correlated(self.distributions, kind)
        return jax.tree.map(self._rule(kind), self.coefficients)

    def _rule(self, kind: AbstractStatistic) -> Callable[[Array], Array]:
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
        if isinstance(kind, Probability):
            return lambda coefficients: sampled_distribution.probability(kind, self._sample(coefficients))
        if isinstance(kind, Quantile):
            return lambda coefficients: sampled_distribution.quantile(kind, self._sample(coefficients))
        return lambda coefficients: kind.of_sample(self._sample(coefficients))

    @override
    def cdf(self, values: Float[Array, " n"]) -> Pytree:
        return self._at_each(sampled_distribution.cdf, values)

    @override
    def pdf(self, values: Float[Array, " n"]) -> Pytree:
        """By a kernel estimate."""
        return self._at_each(sampled_distribution.pdf, values)

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
        found = library.asarray(of_part(away)) / library.where(spreads, variance, 1.0)
        return jax_array(library.where(spreads, library.clip(found, 0.0, 1.0), 0.0))

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
        count, basis = len(self.partition.boxes), self.partition.bases[0]
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
        smallest = min(range(len(self.partition.boxes)), key=lambda k: self.partition.boxes[k].probability)
        box, germs = self.partition.boxes[smallest], self.partition.bases[smallest].germs
        ends = np.array([germ.support() for germ in germs.values()]).T
        places = Placements(dict(self.distributions), {})
        low, high = (inputs_at(places, end, jnp.zeros(0)) for end in ends)
        where = ", ".join(f"{name} from {low[name]:.6g} to {high[name]:.6g}" for name in self.distributions)
        return f"{times}; the smallest element: {where}, probability {box.probability:.2g}"
