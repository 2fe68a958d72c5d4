"""`Expanded`: one expansion of a function of uncertain inputs, with its statistics and errors."""

import math
from collections.abc import Callable, Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array, numbers_to_arrays
from aleator._core.compilation import Use, evaluate
from aleator.analysis._abstract_expanded import AbstractExpanded, checked_points, paired, prepared
from aleator.analysis._expanded_text import as_lines, contributors, distribution_rows, nothing, output_rows, trust
from aleator.analysis._shapley import shapley_matrix
from aleator.ensemble import concrete, part
from aleator.expansion import UNRESOLVED, Basis, Collocation, jackknife, leave_one_out, unseen
from aleator.statistics import AbstractStatistic, a_statistic, cdf, lines_through, pdf, refuse_correlated, varies
from aleator.uncertainty import AbstractDistribution, AbstractGerm

# Outputs that vary by less than this part of their size are constant up to rounding.
_ROUNDING = 1e-12

# Statistics of so few numbers take less time than a program that is any faster.
_FEW = 16


@final
class Expanded(AbstractExpanded):
    """Outputs as polynomials of the germ; `print(expanded)` shows moments, main contributors and errors.

    - `distributions`: the distribution of each uncertain input, by name; `basis`: the orthonormal polynomials;
    - `coefficients`: of each output, shape (terms, *shape);
    - `collocation`, `samples`: the points, and the outputs there, shape (points, *shape); None for a Galerkin solution;
    - `tolerance`: the error up to which an output counts as resolved, as set in the `Expansion`.
    """

    distributions: dict[str, AbstractDistribution]
    basis: Basis = eqx.field(static=True)
    coefficients: Pytree
    collocation: Collocation | None
    samples: Pytree | None
    tolerance: float = UNRESOLVED

    @override
    def __getitem__(self, name: str) -> "Expanded":
        samples = None if self.samples is None else part(self.samples, name)
        return Expanded(
            self.distributions, self.basis, part(self.coefficients, name), self.collocation, samples, self.tolerance
        )

    def _both(self, first: str, second: str) -> "Expanded":
        return Expanded(self.distributions, self.basis, paired(self.coefficients, first, second), None, None)

    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """Raises `ProblemError` for Sobol indices of correlated inputs."""
        refuse_correlated(self.distributions, a_statistic(kind))
        numbers, rest = eqx.partition(numbers_to_arrays(kind), eqx.is_array)

        def of(numbers: Pytree, constants: Pytree, terms: Array) -> Array:
            return eqx.combine(numbers, rest).of(terms, constants)

        constants = prepared(kind.preparation, self.basis)
        return jax.tree.map(lambda terms: evaluate(of, numbers, constants, terms, use=_use(terms)), self.coefficients)

    @override
    def cdf(self, values: Float[Array, " n"]) -> Pytree:
        lines = prepared(lines_through, self.basis)
        return jax.tree.map(lambda terms: _at(cdf, values, terms, lines), self.coefficients)

    @override
    def pdf(self, values: Float[Array, " n"]) -> Pytree:
        lines = prepared(lines_through, self.basis)
        return jax.tree.map(lambda terms: _at(pdf, values, terms, lines), self.coefficients)

    def shapley(self, name: str) -> Pytree:
        """The share of the variance that an input contributes, correlated or not, from 0 to 1 (Shapley effect).

        The shares of all inputs add up to one. For independent inputs it is the sum of the Sobol indices, with those of
        interactions shared equally. Zero if the output does not vary.

        Raises `ProblemError` for an unknown input, and for more than 12.
        """
        matrix = jax_array(shapley_matrix(self.distributions, self.basis, name))
        return jax.tree.map(lambda terms: _part_of_variance(terms, matrix), self.coefficients)

    @property
    def leave_one_out(self) -> Pytree:
        """The relative leave-one-out error of each output, an rms over the standard deviation.

        0 is perfect, 1 is no better than the mean. NaN for a Galerkin solution, which has no samples to predict.
        """
        return self.checked(leave_one_out)

    @property
    def jackknife(self) -> Pytree:
        """The relative error of each output due to the choice of points, an rms over the distribution of the inputs.

        Far above `leave_one_out`, it shows that the expansion extrapolates, as into tails without points.
        """
        return self.checked(jackknife)

    @property
    def error(self) -> Pytree:
        """The estimated relative error of each output, to be compared with `tolerance`.

        It is the leave-one-out or the jackknife error, whichever is larger. Sparse grids, interpolation and Galerkin
        projection have neither: there the error is extrapolated from the decay of the degrees. If each degree is a
        fraction `r` of the one before, `highest_degree_share` is `r**(2 (order - step))`, and the error about
        `r**order`, both relative to the spread (`step` is 1 up to order 2, else 2).
        """
        order = self.basis.order
        exponent = order / (2 * max(order - _step(self.basis), 1))
        worst = jax.tree.map(_larger, self.leave_one_out, self.jackknife)
        pairs = worst, self.highest_degree_share
        return jax.tree.map(lambda error, share: _or_decayed(error, share, exponent), *pairs)

    def checked(self, check: Callable[..., Any]) -> Pytree:
        """`check(collocation, samples, coefficients)` of each output; NaN if there are no samples."""
        if self.samples is None:
            return jax.tree.map(lambda _: jax_array(jnp.nan), self.coefficients)
        return jax.tree.map(lambda *both: jax_array(check(self.collocation, *both)), self.samples, self.coefficients)

    @property
    def highest_degree_share(self) -> Pytree:
        """The part of each output's variance in the terms at the edge of the basis, summed over entries and relative.

        A term is at the edge if one more degree in a variable that it depends on leaves the index set; from order 3 on
        two more degrees, because an even response has no odd terms. A large part shows that the order is too low.
        """
        highest = _edge(self.basis)
        return jax.tree.map(lambda terms: _share(terms, highest), self.coefficients)

    @property
    @override
    def germs(self) -> Mapping[str, AbstractGerm]:
        return self.basis.germs

    @override
    def at_germ(self, points: Float[np.ndarray, "n variables"]) -> Pytree:
        matrix = self.basis.matrix(checked_points(points, self.germs))
        return jax.tree.map(lambda terms: _product(matrix, terms), self.coefficients)

    def __str__(self) -> str:
        checks = self.leave_one_out, self.jackknife, self.error
        remarks = jax.tree.map(self._remark, self.coefficients, *checks)
        rows = [
            ("expansion", self._how()),
            *distribution_rows(self.distributions),
            *output_rows(self.mean, self.std, remarks),
        ]
        points = None if self.collocation is None else concrete(self.collocation.points)
        corner = None if points is None else unseen(self.basis, points)
        return as_lines(rows if corner is None else [*rows, ("not seen", corner.sentence())])

    def _how(self) -> str:
        variables = self.basis.variables
        how = f"order {self.basis.order} in {variables} variable{'s' * (variables != 1)}, {self.basis.terms} terms"
        if self.collocation is None:
            return f"{how}, Galerkin"
        condition = concrete(self.collocation.condition_number)
        told = "" if condition is None else f", condition number {float(condition):.3g}"
        return f"{how}, {len(self.collocation.points)} points{told}"

    def _remark(self, terms: Array, checked: Array, jackknife: Array, error: Array) -> Callable[[tuple], str]:
        """The text on one entry of an output after its moments: where its spread comes from, and its error."""
        known, loo, left, missed = map(concrete, (terms, checked, jackknife, error))
        if known is None:
            return nothing
        trusted = trust(loo, left, missed, self.tolerance)
        return lambda entry: (
            f"; {contributors(self.distributions, self.basis, known[(slice(None), *entry)])}; {trusted}"
        )


def _edge(basis: Basis) -> Bool[np.ndarray, " terms"]:
    """Which terms are at the edge of the index set; see `highest_degree_share`."""
    known = set(map(tuple, basis.indices.tolist()))
    step = _step(basis)

    def ends(term: tuple[int, ...]) -> bool:
        raised = ((*term[:i], degree + step, *term[i + 1 :]) for i, degree in enumerate(term) if degree)
        return any(one not in known for one in raised)

    return np.array([ends(tuple(term)) for term in basis.indices.tolist()])


def _step(basis: Basis) -> int:
    return 2 if basis.order > 2 else 1


def _part_of_variance(terms: Float[Array, "terms *shape"], matrix: Float[Array, "terms terms"]) -> Array:
    part = jnp.sum(terms * jnp.tensordot(matrix, terms, axes=1), axis=0)
    total, spreads = jnp.sum(terms[1:] ** 2, axis=0), varies(terms)
    return jnp.where(spreads, part / jnp.where(spreads, total, 1.0), 0.0)


def _use(terms: Float[Array, "terms *shape"]) -> Use:
    return Use.ONCE if math.prod(terms.shape[1:]) <= _FEW else Use.LOOPS


def _at(function: Callable[..., Array], values: Any, terms: Float[Array, "terms *shape"], lines: Pytree) -> Array:
    """The distribution function of an output, or its density, at some values."""
    return evaluate(function, jax_array(values), terms, lines, use=_use(terms))


def _product(matrix: Float[np.ndarray, "n terms"], terms: Float[Array, "terms *shape"]) -> Float[Array, "n *shape"]:
    library, known = in_library(terms)
    return jax_array(library.tensordot(matrix, known, axes=1))


def _larger(one: Float[Array, "*shape"], other: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    library, *both = in_library(one, other)
    return jax_array(library.maximum(*both))


def _or_decayed(error: Float[Array, ""], share: Float[Array, ""], exponent: float) -> Float[Array, ""]:
    library, error, share = in_library(error, share)
    return jax_array(library.where(library.isfinite(error), error, share**exponent))


def _share(terms: Float[Array, "terms *shape"], highest: np.ndarray) -> Float[Array, ""]:
    library, terms = in_library(terms)
    total = library.sum(terms[1:] ** 2)
    # Compared so that NaN and infinite values do not pass for constant.
    constant = (total == 0) | (total < _ROUNDING**2 * library.sum(terms**2))
    of_highest = library.sum(terms[highest] ** 2)
    return jax_array(library.where(constant, 0.0, of_highest / library.where(constant, 1.0, total)))
