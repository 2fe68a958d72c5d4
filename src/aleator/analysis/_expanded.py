"""`Expanded`: a function of uncertain inputs by one expansion, with errors and Shapley effects; `ElementExpanded`."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import combinations
from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, in_library, jax_array
from aleator._core.errors import ProblemError
from aleator.analysis._abstract_expanded import (
    AbstractExpanded,
    as_lines,
    contributors,
    distribution_rows,
    nothing,
    output_rows,
    paired,
    trust,
)
from aleator.ensemble import concrete, inputs_at, part
from aleator.expansion import (
    ROUNDING,
    UNRESOLVED,
    AbstractBasis,
    Collocation,
    PiecewiseBasis,
    jackknife,
    leave_one_out,
    leave_one_out_of_entries,
    unseen,
)
from aleator.statistics import varies
from aleator.uncertainty import AbstractDistribution, Placements

_MOST_INPUTS = 12


@final
class Expanded(AbstractExpanded):
    """Outputs as polynomials of the germ; `print(expanded)` shows moments, main contributors and errors.

    - `distributions`: the distribution of each uncertain input, by name; `basis`: the orthonormal polynomials;
    - `coefficients`: of each output, shape (terms, *shape);
    - `collocation`, `samples`: the points, and the outputs there, shape (points, *shape); None for a Galerkin solution;
    - `fresh_error`: of each output, the rms error at fresh points, which no coefficient follows from, over the spread;
      None where there are none;
    - `tolerance`: the error up to which an output counts as resolved, as set in the `Expansion`.
    """

    distributions: dict[str, AbstractDistribution]
    basis: AbstractBasis = eqx.field(static=True)
    coefficients: Pytree
    collocation: Collocation | None
    samples: Pytree | None
    fresh_error: Pytree | None = None
    tolerance: float = UNRESOLVED

    @override
    def __getitem__(self, name: str) -> "Expanded":
        coefficients = part(self.coefficients, name)
        samples, error = (None if tree is None else part(tree, name) for tree in (self.samples, self.fresh_error))
        return Expanded(self.distributions, self.basis, coefficients, self.collocation, samples, error, self.tolerance)

    def _both(self, first: str, second: str) -> "Expanded":
        return Expanded(self.distributions, self.basis, paired(self.coefficients, first, second), None, None)

    @override
    def _known(self) -> tuple[Collocation | None, list[Any]]:
        outputs = jax.tree.leaves(self.coefficients)
        return self.collocation, [None] * len(outputs) if self.samples is None else jax.tree.leaves(self.samples)

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

        It is the largest of the leave-one-out, the jackknife and the fresh error. Sparse grids, interpolation and
        Galerkin projection have none of the former two. Without a fresh error either, as after a Galerkin projection,
        it is extrapolated from the decay of the degrees. If each degree is a fraction `r` of the one before,
        `highest_degree_share` is `r**(2 (order - step))`, and the error about `r**order`, both relative to the spread
        (`step` is 1 up to order 2, else 2).
        """
        order = self.basis.order
        exponent = order / (2 * max(order - _step(self.basis), 1))
        worst = jax.tree.map(_larger, self.leave_one_out, self.jackknife)
        if self.fresh_error is None:
            return jax.tree.map(lambda error, share: _known(error, share**exponent), worst, self.highest_degree_share)
        return jax.tree.map(lambda error, fresh: _larger(_known(error, fresh), fresh), worst, self.fresh_error)

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

    def __str__(self) -> str:
        checks = self.leave_one_out, self.jackknife, self.error
        remarks = jax.tree.map(self._remark, self.coefficients, *checks, self.checked(leave_one_out_of_entries))
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
        measure = "" if condition is None else f", condition number {float(condition):.3g}"
        return f"{how}, {len(self.collocation.points)} points{measure}"

    def _remark(
        self, terms: Array, checked: Array, jackknife: Array, error: Array, entries: Array
    ) -> Callable[[tuple], str]:
        """The text on one entry of an output after its moments: where its spread comes from, and its error.

        An array that is resolved on the whole may have an entry, or an instant, of little spread that is not.
        """
        known, loo, left, missed, each = map(concrete, (terms, checked, jackknife, error, entries))
        if known is None or missed is None or each is None:
            return nothing
        trusted = trust(loo, left, missed, self.tolerance, is_fresh=self.fresh_error is not None)
        worst = np.unravel_index(int(np.argmax(each)), each.shape)
        if each.ndim and each[worst] > self.tolerance >= float(missed):
            trusted += f" on the whole; [{', '.join(map(str, worst))}] is off by {each[worst]:.2g} of its own spread"
        return lambda entry: (
            f"; {contributors(self.distributions, self.basis, known[(slice(None), *entry)])}; {trusted}"
        )


@final
class ElementExpanded(AbstractExpanded):
    """Outputs as polynomials of the germ in each element of its domain; `print(expanded)` shows a summary.

    - `distributions`: that of each uncertain input, by name; `basis`: the elements, with the polynomials in each;
    - `coefficients`: of each output in the basis, shape (elements x terms, *shape);
    - `splits`: the variable of each split, in order; `calls`: how often the function was called;
    - `error`: estimated relative rms error of the piecewise expansion, the largest over the outputs.
    """

    distributions: dict[str, AbstractDistribution]
    basis: AbstractBasis = eqx.field(static=True)
    coefficients: Pytree
    splits: tuple[str, ...] = eqx.field(static=True)
    calls: int = eqx.field(static=True)
    error: float = eqx.field(static=True)

    @override
    def __getitem__(self, name: str) -> "ElementExpanded":
        return self._with(part(self.coefficients, name))

    def _both(self, first: str, second: str) -> "ElementExpanded":
        return self._with(paired(self.coefficients, first, second))

    def _with(self, coefficients: Pytree) -> "ElementExpanded":
        return ElementExpanded(self.distributions, self.basis, coefficients, self.splits, self.calls, self.error)

    @property
    def partition(self) -> PiecewiseBasis:
        """The elements, with the polynomials in each."""
        assert isinstance(self.basis, PiecewiseBasis)
        return self.basis

    def __str__(self) -> str:
        count, basis = len(self.partition.cells), self.partition.pieces[0]
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
        cell, germs = self.partition.cells[smallest], self.partition.pieces[smallest].germs
        ends = np.array([germ.support() for germ in germs.values()]).T
        places = Placements(dict(self.distributions), {})
        low, high = (inputs_at(places, end, jnp.zeros(0)) for end in ends)
        where = ", ".join(f"{name} from {low[name]:.6g} to {high[name]:.6g}" for name in self.distributions)
        return f"{times}; the smallest element: {where}, probability {cell.probability:.2g}"


def _edge(basis: AbstractBasis) -> Bool[np.ndarray, " terms"]:
    """Which terms are at the edge of the index set; see `highest_degree_share`."""
    known = set(map(tuple, basis.indices.tolist()))
    step = _step(basis)

    def ends(term: tuple[int, ...]) -> bool:
        raised = ((*term[:i], degree + step, *term[i + 1 :]) for i, degree in enumerate(term) if degree)
        return any(higher not in known for higher in raised)

    return np.array([ends(tuple(term)) for term in basis.indices.tolist()])


def _step(basis: AbstractBasis) -> int:
    return 2 if basis.order > 2 else 1


def _part_of_variance(terms: Float[Array, "terms *shape"], matrix: Float[Array, "terms terms"]) -> Array:
    library, terms, matrix, spreads = in_library(terms, matrix, varies(terms))
    part = library.sum(terms * library.tensordot(matrix, terms, axes=1), axis=0)
    total = library.sum(terms[1:] ** 2, axis=0)
    return jax_array(library.where(spreads, part / library.where(spreads, total, 1.0), 0.0))


def _larger(first: Float[Array, "*shape"], second: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    library, *both = in_library(first, second)
    return jax_array(library.maximum(*both))


def _known(error: Float[Array, ""], other: Float[Array, ""]) -> Float[Array, ""]:
    library, error, other = in_library(error, other)
    return jax_array(library.where(library.isfinite(error), error, other))


def _share(terms: Float[Array, "terms *shape"], highest: np.ndarray) -> Float[Array, ""]:
    library, terms = in_library(terms)
    total = library.sum(terms[1:] ** 2)
    # Compared so that NaN and infinite values do not pass for constant.
    constant = (total == 0) | (total < ROUNDING**2 * library.sum(terms**2))
    of_highest = library.sum(terms[highest] ** 2)
    return jax_array(library.where(constant, 0.0, of_highest / library.where(constant, 1.0, total)))


Matrix: TypeAlias = Float[np.ndarray, "terms terms"]


def shapley_matrix(distributions: Mapping[str, AbstractDistribution], basis: AbstractBasis, name: str) -> Matrix:
    """The matrix `W` of an input: its part of the variance is `cᵀ W c` for coefficients `c`.

    The share of an input is the explained variance `Var E[y | inputs]` that it adds, averaged over all orders in which
    the inputs may become known. Sources: Owen, SIAM/ASA Journal on Uncertainty Quantification 2 (2014); Song, Nelson
    and Staum (2016); for correlated normal inputs Owen and Prieur (2017).

    Raises `ProblemError` for an unknown input, and for too many inputs to form all subsets.
    """
    if name not in distributions:
        raise ProblemError(f"shapley: there is no uncertain input '{name}'; expected one of {list(distributions)}.")
    if len(distributions) > _MOST_INPUTS:
        raise ProblemError(
            f"shapley: expected at most {_MOST_INPUTS} uncertain inputs, of which all subsets are formed; received "
            f"{len(distributions)}. Hold those of little influence at their means."
        )
    explained = _explained(distributions, basis)
    others = [other for other in distributions if other != name]
    count, total = len(distributions), np.zeros((basis.terms, basis.terms))
    for size in range(count):
        weight = math.factorial(size) * math.factorial(count - size - 1) / math.factorial(count)
        for known in combinations(others, size):
            total += weight * (explained(frozenset({*known, name})) - explained(frozenset(known)))
    return total


def _explained(
    distributions: Mapping[str, AbstractDistribution], basis: AbstractBasis
) -> Callable[[frozenset[str]], Matrix]:
    """The matrix of `Var E[y | known]` for any set of known inputs: a product over independent inputs and groups."""
    factors = list(_factors(distributions, basis))
    mean = np.zeros((basis.terms, basis.terms))
    mean[0, 0] = 1.0

    def of(known: frozenset[str]) -> Matrix:
        parts = (factor(known & names) for names, factor in factors)
        return math.prod(parts, start=np.ones((basis.terms, basis.terms))) - mean

    return of


def _factors(
    distributions: Mapping[str, AbstractDistribution], basis: AbstractBasis
) -> Iterator[tuple[frozenset[str], Callable[[frozenset[str]], Matrix]]]:
    """For each independent input, and for each correlated group: the inputs, and the matrix of their germ variables."""
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, distribution in distributions.items():
        key = name if distribution.dependence is None else distribution.dependence.group
        place = [basis.names.index(germ) for germ in distribution.germ_names(name)]
        row = np.zeros(basis.variables)
        row[place] = (
            1.0
            if distribution.dependence is None
            else distribution.dependence.factor[distribution.dependence.index][: len(place)]
        )
        groups.setdefault(key, {})[name] = row
    for members in groups.values():
        used = np.flatnonzero(np.any(list(members.values()), axis=0))
        rows = {name: row[used] for name, row in members.items()}
        yield frozenset(members), cache(_group(rows, basis.indices[:, used]))


def _group(rows: Mapping[str, np.ndarray], degrees: np.ndarray) -> Callable[[frozenset[str]], Matrix]:
    """`E[p_i q_j]` of terms in standard normal variables, for `q` in the conditional means given the known inputs.

    Known inputs are `rows @ germs`; the germs' conditional means are an orthogonal projection `M` of the germs.
    """
    unique, where = np.unique(degrees, axis=0, return_inverse=True)

    def of(known: frozenset[str]) -> Matrix:
        chosen = np.array([row for name, row in rows.items() if name in known]).reshape(-1, degrees.shape[1])
        projection = chosen.T @ np.linalg.solve(chosen @ chosen.T, chosen) if known else 0.0 * np.eye(degrees.shape[1])
        small = np.zeros((len(unique), len(unique)))
        for j, second in enumerate(unique):
            powers = _powers_of(projection, tuple(map(int, second)))
            for i, first in enumerate(unique):
                small[i, j] = _root(first) / _root(second) * powers.get(tuple(map(int, first)), 0.0)
        return small[np.ix_(where.ravel(), where.ravel())]

    return of


def _root(degrees: np.ndarray) -> float:
    return math.sqrt(math.prod(math.factorial(int(degree)) for degree in degrees))


def _powers_of(matrix: np.ndarray, degrees: tuple[int, ...]) -> dict[tuple[int, ...], float]:
    """The polynomial `(M x)^degrees` by its monomials.

    For orthonormal Hermite polynomials in jointly normal variables `u`, `v` with covariance `M`, `E[p_a(u) q_b(v)]` is
    its coefficient of `x^a` times `sqrt(a! / b!)` (Mehler's formula in several variables).
    """
    count = len(degrees)
    polynomial: dict[tuple[int, ...], float] = {(0,) * count: 1.0}
    for row, degree in zip(matrix, degrees, strict=True):
        for _ in range(degree):
            step: dict[tuple[int, ...], float] = {}
            for monomial, factor in polynomial.items():
                for k in range(count):
                    raised = (*monomial[:k], monomial[k] + 1, *monomial[k + 1 :])
                    step[raised] = step.get(raised, 0.0) + factor * row[k]
            polynomial = step
    return polynomial
