"""Shapley effects: the variance of an output divided among its inputs, which may be correlated.

The share of an input is the explained variance `Var E[y | inputs]` that it adds, averaged over all orders in which the
inputs may become known. Sources: Owen, SIAM/ASA Journal on Uncertainty Quantification 2 (2014); Song, Nelson and Staum
(2016); for correlated normal inputs Owen and Prieur (2017).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import combinations
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.uncertainty import AbstractDistribution

Matrix: TypeAlias = Float[np.ndarray, "terms terms"]

_MOST_INPUTS = 12


def shapley_matrix(distributions: Mapping[str, AbstractDistribution], basis: Basis, name: str) -> Matrix:
    """The matrix `W` of an input: its part of the variance is `cᵀ W c` for coefficients `c`.

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
    others = [one for one in distributions if one != name]
    count, total = len(distributions), np.zeros((basis.terms, basis.terms))
    for size in range(count):
        weight = math.factorial(size) * math.factorial(count - size - 1) / math.factorial(count)
        for known in combinations(others, size):
            total += weight * (explained(frozenset({*known, name})) - explained(frozenset(known)))
    return total


def _explained(distributions: Mapping[str, AbstractDistribution], basis: Basis) -> Callable[[frozenset[str]], Matrix]:
    """The matrix of `Var E[y | known]` for any set of known inputs: a product over independent inputs and groups."""
    factors = list(_factors(distributions, basis))
    mean = np.zeros((basis.terms, basis.terms))
    mean[0, 0] = 1.0

    def of(known: frozenset[str]) -> Matrix:
        parts = (factor(known & names) for names, factor in factors)
        return math.prod(parts, start=np.ones((basis.terms, basis.terms))) - mean

    return of


def _factors(
    distributions: Mapping[str, AbstractDistribution], basis: Basis
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
    found: dict[tuple[int, ...], float] = {(0,) * count: 1.0}
    for row, degree in zip(matrix, degrees, strict=True):
        for _ in range(degree):
            step: dict[tuple[int, ...], float] = {}
            for monomial, factor in found.items():
                for k in range(count):
                    raised = (*monomial[:k], monomial[k] + 1, *monomial[k + 1 :])
                    step[raised] = step.get(raised, 0.0) + factor * row[k]
            found = step
    return found
