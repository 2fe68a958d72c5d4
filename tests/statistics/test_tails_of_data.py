"""Tails of expansions in data: refused, for between single values there is nothing to integrate."""

import numpy as np
import pytest

import aleator as al

DATA = np.array([0.97, 0.99, 1.01, 1.02, 1.05])


def test_tails_of_an_expansion_in_data_are_refused_with_a_remedy():
    expanded = al.expand(
        lambda at: at["x"] + at["y"], {"x": al.Sample(DATA), "y": al.Normal(0.0, 1.0)}, al.Expansion(1)
    )
    with pytest.raises(al.ProblemError, match=r"sample of data for .x., which takes single values\."):
        expanded.quantile(0.9)


def test_moments_and_extremes_of_an_expansion_in_data_are_those_of_the_data():
    expanded = al.expand(lambda at: at["x"], {"x": al.Sample(DATA)}, al.Expansion(1))
    assert float(expanded.mean) == pytest.approx(DATA.mean(), rel=1e-12)
    assert float(expanded.std) == pytest.approx(DATA.std(), rel=1e-9)


def test_a_density_around_zero_has_tails():
    tent = al.Density(lambda x: 1 - np.abs(x), -1.0, 1.0)
    expanded = al.expand(lambda at: at["x"], {"x": tent}, al.Expansion(1))
    assert float(expanded.quantile(0.9)) == pytest.approx(1 - np.sqrt(0.2), rel=1e-6)


def test_a_called_function_that_returns_one_array_again_and_again_is_read_each_time():
    kept = np.zeros(1)

    def simulator(at):
        kept[0] = at["u"] ** 2
        return kept

    distributions = {"u": al.Uniform.bounds(0.0, 1.0)}
    expanded = al.expand(simulator, distributions, al.Expansion(3), traced=False)
    np.testing.assert_allclose(expanded.mean, [1 / 3], rtol=1e-6)
    sampled = al.references.monte_carlo(simulator, distributions, samples=64, traced=False)
    assert len(np.unique(sampled.values)) == 64


def test_a_constant_is_said_not_to_vary():
    expanded = al.expand(lambda at: 3.0 + 0 * at["x"], {"x": al.Normal(0.0, 1.0)}, al.Expansion(2))
    assert "it does not vary" in str(expanded)
