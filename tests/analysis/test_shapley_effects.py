"""Shapley effects share out variances of correlated inputs, as in closed forms; Sobol indices of them are refused."""

from itertools import combinations
from math import factorial

import numpy as np
import pytest

import aleator as al

SLOPES = {"a": 1.0, "b": -0.7, "c": 0.4}
STDS = {"a": 0.5, "b": 1.0, "c": 2.0}
CORRELATIONS = {("a", "b"): 0.6, ("b", "c"): -0.3, ("a", "c"): 0.2}


def correlated(order):
    return al.correlated({name: al.Normal(1.0, STDS[name]) for name in order}, CORRELATIONS)


def linear(at):
    return sum(SLOPES[name] * at[name] for name in SLOPES)


def exact_of_linear():
    """Owen and Prieur (2017), theorem 2: explained variances are quadratic forms of conditional covariances."""
    names = list(SLOPES)
    slopes, stds = np.array(list(SLOPES.values())), np.array(list(STDS.values()))
    correlation = np.eye(3)
    for (one, other), value in CORRELATIONS.items():
        i, j = names.index(one), names.index(other)
        correlation[i, j] = correlation[j, i] = value
    covariance = correlation * np.outer(stds, stds)

    def explained(known):
        chosen = list(known)
        cross = covariance[:, chosen]
        return slopes @ cross @ np.linalg.solve(covariance[np.ix_(chosen, chosen)], cross.T) @ slopes if chosen else 0.0

    effects = {}
    for i, name in enumerate(names):
        rest = [j for j in range(3) if j != i]
        effects[name] = sum(
            factorial(size) * factorial(2 - size) / 6 * (explained((*known, i)) - explained(known))
            for size in range(3)
            for known in combinations(rest, size)
        ) / (slopes @ covariance @ slopes)
    return effects


def test_effects_of_linear_functions_of_correlated_normals_are_exact():
    expanded = al.expand(linear, correlated("bca"), al.Expansion(order=1))
    for name, exact in exact_of_linear().items():
        np.testing.assert_allclose(expanded.shapley(name), exact, rtol=1e-12)


def test_sobol_indices_of_correlated_inputs_are_refused_with_what_to_take():
    expanded = al.expand(linear, correlated("bca"), al.Expansion(order=1))
    for ask in (expanded.sobol, expanded.total_sobol):
        with pytest.raises(al.ProblemError, match=r"correlated group.*shapley"):
            ask("a")
    with pytest.raises(al.ProblemError, match=r"correlated group.*shapley"):
        al.references.sobol_indices(linear, correlated("bca"), 64)
    assert "(b~c~a) 100 %" in str(expanded)
    with pytest.raises(al.ProblemError, match="no uncertain input 'd'"):
        expanded.shapley("d")
