"""Correlated distributions by a Gaussian copula (the Nataf model).

Each distribution is a function of a normal variable, and these are correlated. Pearson's correlation of two
distributions follows from that of their normals by Mehler's formula, `r = sum over n >= 1 of c_n d_n rho^n / (sigma_1
sigma_2)`, where `c_n` and `d_n` are the coefficients of the two distributions in orthonormal Hermite polynomials; it
is solved for `rho`. Sources: Nataf (1962); Der Kiureghian and Liu, Journal of Engineering Mechanics 112 (1986); Lebrun
and Dutfoy (2009) on the copula.
"""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from aleator._core.arrays import Scalar, in_library, numbers_to_arrays
from aleator._core.border import a_name, real, real_array, refusal
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_traced
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._polynomials import Dependence, HermiteGerm

_TERMS = 100
_NORMALS = np.linspace(-12, 12, 2001)
_PROBABILITIES = np.exp(-(_NORMALS**2) / 2) / np.sum(np.exp(-(_NORMALS**2) / 2))  # the trapezoidal rule is exact here
_SMALLEST_EIGENVALUE = 1e-10
_ROUNDING = 1e-12


def correlated(
    distributions: Mapping[str, AbstractDistribution],
    correlations: Mapping[tuple[str, str], float] | Float[np.ndarray, "n n"],
    *,
    name: str | None = None,
) -> dict[str, AbstractDistribution]:
    """The given distributions, correlated, under the same names; each may be placed anywhere in a model.

    `correlated({"k": Normal(5.0, 0.2), "c": Gamma(mean=2.0, std=0.3)}, {("k", "c"): 0.5})`. The correlations are
    Pearson's, of the uncertain numbers themselves; pairs that are not named are uncorrelated. A full matrix may be
    given, with its rows in the order of `distributions`. Their joint distribution is a Gaussian copula, and `name`
    (default: the members' names, joined) is that of the group, which a model may contain only once.

    The distributions may contain decisions. Decisions that set a location or scale leave the correlations as given.
    Where one sets a shape, the correlations hold at its initial value, and the copula does not change.

    Raises `ProblemError` if the correlations do not form a correlation matrix, or if these distributions cannot attain
    them.
    """
    if not isinstance(distributions, Mapping):
        raise refusal("correlated", "distributions by name", distributions)
    members = tuple(distributions)
    for member, distribution in distributions.items():
        _check_member(member, distribution)
    if len(members) < 2:
        raise ProblemError(
            f"correlated: expected at least two distributions; received {len(members)}. Place a single one as it is."
        )
    pearson = _matrix(members, correlations)
    _check_matrix(pearson, members)
    normal = _nataf(distributions, pearson)
    _refuse_indefinite(normal, "No Gaussian copula gives these distributions these correlations")
    factor = np.linalg.cholesky(normal)
    group = "~".join(members) if name is None else a_name("correlated: name", name)
    return {
        member: distribution.with_fields(dependence=Dependence(group, members, index, factor))
        for index, (member, distribution) in enumerate(distributions.items())
    }


def refuse_correlated(distributions: Mapping[str, AbstractDistribution], names: Iterable[str]) -> None:
    """Raise `ProblemError` for a Sobol index of correlated inputs, or of their germ variables.

    It would be that of the germ variables, which depend on the order in which the group was declared; the variance of
    correlated inputs has no such decomposition.
    """
    groups = {
        name: distribution.dependence.group
        for place, distribution in distributions.items()
        if distribution.dependence is not None
        for name in (place, *distribution.germ_names(place))
    }
    for name in names:
        if name in groups:
            raise ProblemError(
                f"Sobol index: '{name}' belongs to the correlated group '{groups[name]}', whose variance has no parts "
                "that belong to one input alone. Take Shapley effects, which share it out among inputs: "
                "al.expand(...).shapley(name), without elements."
            )


def _check_member(member: str, distribution: Any) -> None:
    if not isinstance(distribution, AbstractDistribution):
        raise ProblemError(
            f"'{member}': only distributions can be correlated; received {type(distribution).__name__} "
            f"{distribution!r}."
        )
    if distribution.dependence is not None:
        raise ProblemError(
            f"'{member}' is correlated already, as {distribution.dependence}. Correlate all distributions in one group."
        )
    if is_traced(distribution.initial().canonical().shape):
        raise ProblemError(
            f"'{member}': the shape of a correlated distribution cannot be traced by JAX, since the copula is computed "
            "from it. Make the shape a plain number, or a Decision (the copula is then that of its initial value)."
        )


def _matrix(members: tuple[str, ...], correlations: Any) -> Float[np.ndarray, "n n"]:
    """The correlations as a matrix, in the order of the members."""
    count = len(members)
    if not isinstance(correlations, Mapping):
        expected = f"a number for each pair by its names, or a matrix of shape ({count}, {count})"
        matrix = real_array("correlations", correlations, expected)
        if matrix.shape != (count, count):
            raise refusal("correlations", expected, correlations)
        return matrix
    matrix = np.eye(count)
    named: set[frozenset[str]] = set()
    for pair, value in correlations.items():
        if not (isinstance(pair, tuple) and len(pair) == 2 and pair[0] != pair[1] and set(pair) <= set(members)):
            raise ProblemError(
                f"Correlations are named by pairs of two of the distributions {', '.join(members)}; received {pair!r}."
            )
        if frozenset(pair) in named:
            raise ProblemError(f"The correlation of '{pair[0]}' and '{pair[1]}' is given twice. Give it once.")
        named.add(frozenset(pair))
        i, j = map(members.index, pair)
        matrix[i, j] = matrix[j, i] = real(f"The correlation of {pair!r}", value)
    return matrix


def _check_matrix(matrix: Float[np.ndarray, "n n"], members: tuple[str, ...]) -> None:
    """Refuse anything but a correlation matrix, naming the entry or the eigenvalue."""
    possible = np.where(np.eye(len(members)), np.abs(matrix - 1) <= _ROUNDING, np.abs(matrix) < 1)
    wrong = ~(possible & (np.abs(matrix - matrix.T) <= _ROUNDING))
    if wrong.any():
        i, j = map(int, np.argwhere(wrong)[0])
        raise ProblemError(
            "correlations: expected a symmetric matrix with ones on its diagonal and numbers between -1 and 1 "
            f"elsewhere (`shared` makes two numbers always equal); received {matrix[i, j]:g} for '{members[i]}' and "
            f"'{members[j]}', {matrix[j, i]:g} for '{members[j]}' and '{members[i]}'."
        )
    _refuse_indefinite(matrix, "These correlations contradict each other: no random variables have them")


def _refuse_indefinite(matrix: Float[np.ndarray, "n n"], what: str) -> None:
    smallest = np.linalg.eigvalsh(matrix)[0]
    if smallest < _SMALLEST_EIGENVALUE:
        raise ProblemError(
            f"{what}: expected a positive definite correlation matrix; received one with the smallest eigenvalue "
            f"{smallest:.3g}. Bring the correlations closer to 0."
        )


def _nataf(
    distributions: Mapping[str, AbstractDistribution], pearson: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    """Correlations of the normals that give the distributions the correlations `pearson`."""
    standard = {member: _standard_values(one.initial()) for member, one in distributions.items()}
    normal = np.eye(len(distributions))
    for (i, first), (j, second) in itertools.combinations(enumerate(distributions), 2):
        if pearson[i, j] != 0:
            pair = standard[first], standard[second]
            normal[i, j] = normal[j, i] = _normal_correlation(pearson[i, j], *pair, names=(first, second))
    return normal


def _standard_values(distribution: AbstractDistribution) -> Float[Array, " n"]:
    """The distribution's standardised values (zero mean, unit standard deviation) at `_NORMALS`."""

    def standardised(shape: tuple[Array, ...]) -> Float[Array, " n"]:
        values = jax.vmap(lambda normal: distribution.from_normal(normal, shape))(jnp.asarray(_NORMALS))
        values = values - _PROBABILITIES @ values
        return values / jnp.sqrt(_PROBABILITIES @ values**2)

    # Location and scale, which may be traced where the shape is not, do not matter.
    return evaluate(standardised, numbers_to_arrays(distribution.canonical().shape), use=Use.ONCE)


def _normal_correlation(wanted: float, first: Array, second: Array, *, names: tuple[str, str]) -> float:
    """The normals' correlation that gives the standardised values `first` and `second` the correlation `wanted`."""
    correlation = np.polynomial.Polynomial(_mehler(first, second))
    lowest, highest = correlation(-1.0), correlation(1.0)
    if not lowest < wanted < highest:
        raise ProblemError(
            f"'{names[0]}' and '{names[1]}' cannot have the correlation {wanted:g}: for these distributions it lies "
            f"between {lowest:.4g} and {highest:.4g}. Choose one in between."
        )
    return scipy.optimize.root_scalar(lambda rho: correlation(rho) - wanted, bracket=(-1.0, 1.0), xtol=1e-15).root


def _mehler(first: Float[Array, " n"], second: Float[Array, " n"]) -> Any:
    """Pearson's correlation of standardised values as a polynomial in that of their normals, by rising powers."""
    _, first, second = in_library(first, second)
    hermite = HermiteGerm().polynomials(_TERMS, _NORMALS)
    return ((_PROBABILITIES * first) @ hermite) * ((_PROBABILITIES * second) @ hermite)


def pearson(distributions: Mapping[str, AbstractDistribution]) -> dict[tuple[str, str], Scalar]:
    """Pearson's correlation of each two distributions that a group correlates, by their names.

    A JAX function of their parameters; of decisions there are none left.
    """
    correlations = {}
    members = {name: member.dependence for name, member in distributions.items() if member.dependence is not None}
    standard = {name: _standard_values(distributions[name]) for name in members}
    for (first, member), (second, other) in itertools.combinations(members.items(), 2):
        if member.group == other.group:
            library, factor, terms = in_library(member.factor, _mehler(standard[first], standard[second]))
            correlations[first, second] = library.polyval(terms[::-1], factor[member.index] @ factor[other.index])
    return correlations
