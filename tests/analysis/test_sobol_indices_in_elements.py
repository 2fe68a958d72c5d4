"""Sobol indices of multi-element expansions against closed forms."""

from itertools import chain, combinations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator._core import arrays

BOTH = {"x": al.Uniform.bounds(-1.0, 1.0), "y": al.Uniform.bounds(-1.0, 1.0)}


def indices(expanded, names):
    """The index of every set of inputs."""
    sets = chain.from_iterable(combinations(names, size) for size in range(1, len(names) + 1))
    return {one: float(expanded.sobol(*one)) for one in sets}


def test_a_kink_under_distributions_that_are_not_uniform():
    """`|z| b` with z standard normal and b of Beta(2, 5): moments in closed form."""
    beta = stats.beta(2, 5)
    first, second = beta.mean(), beta.var() + beta.mean() ** 2
    total = second - 2 / np.pi * first**2
    model = {"z": al.Normal(0.0, 1.0), "b": al.Beta(alpha=2.0, beta=5.0, lower=0.0, upper=1.0)}
    pieces = al.expand(lambda m: jnp.abs(m["z"]) * m["b"], model, al.MultiElement(2))
    by_z, by_b = first**2 * (1 - 2 / np.pi) / total, 2 / np.pi * beta.var() / total
    expected = {("z",): by_z, ("b",): by_b, ("z", "b"): 1 - by_z - by_b}
    assert len(pieces.partition.cells) > 1
    assert indices(pieces, "zb") == pytest.approx(expected, abs=1e-7)
    assert float(pieces.total_sobol("z")) == pytest.approx(1 - by_b, abs=1e-7)


def test_ishigamis_function_has_its_published_indices_which_add_up_to_one():
    model = {name: al.Uniform.bounds(-np.pi, np.pi) for name in ("x1", "x2", "x3")}
    pieces = al.expand(
        lambda m: jnp.sin(m["x1"]) + 7 * jnp.sin(m["x2"]) ** 2 + 0.1 * m["x3"] ** 4 * jnp.sin(m["x1"]),
        model,
        al.MultiElement(5, error=0.02),
    )
    assert len(pieces.partition.cells) > 4
    found = indices(pieces, ("x1", "x2", "x3"))
    expected = {("x1",): 0.3139051912, ("x2",): 0.4424111448, ("x1", "x3"): 0.2436836641}
    assert found == pytest.approx({one: expected.get(one, 0.0) for one in found}, abs=1e-3)
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-12)
    with_x3 = sum(value for one, value in found.items() if "x3" in one)
    assert float(pieces.total_sobol("x3")) == pytest.approx(with_x3, abs=1e-12)


def test_indices_that_there_are_not_are_refused_as_those_of_a_single_expansion(monkeypatch):
    distributions = al.correlated({"x": al.Normal(0.0, 1.0), "y": al.Normal(0.0, 1.0)}, {("x", "y"): 0.5})
    tied = al.expand(lambda m: jnp.abs(m["x"]) + m["y"], distributions, al.MultiElement(2, error=0.3))
    with pytest.raises(al.ProblemError, match=r"'x' belongs to the correlated group .*\.shapley\(name\)"):
        tied.sobol("x")
    pieces = al.expand(lambda m: m["x"] * jnp.abs(m["y"]), BOTH, al.MultiElement())
    with pytest.raises(al.ProblemError, match=r"no germ variable 'z'\. Expected one of \['x', 'y'\]"):
        pieces.sobol("z")
    monkeypatch.setattr(arrays, "memory", lambda: 1000)
    with pytest.raises(
        al.ProblemError, match=r"pairs of 5 terms in 2 elements would need .*al\.references\.sobol_indices"
    ):
        pieces.sobol("x")
