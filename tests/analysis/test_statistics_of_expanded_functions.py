"""What an expanded function is asked, against closed forms, chaospy, sampling and finite differences."""

import chaospy
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al

MODEL = {"a": al.Uniform.bounds(0.0, 1.0), "b": al.Normal(0.0, 0.5)}


def response(m):
    return m["a"] ** 2 + 0.5 * m["b"] + m["a"] * m["b"] ** 2


def test_every_moment_and_index_of_a_polynomial_is_that_of_chaospy():
    joint = chaospy.J(chaospy.Uniform(0, 1), chaospy.Normal(0, 0.5))
    a, b = chaospy.variable(2)
    polynomial = a**2 + 0.5 * b + a * b**2
    ours = al.expand(response, MODEL, al.Expansion(3))
    expected = {
        "mean": chaospy.E,
        "variance": chaospy.Var,
        "std": chaospy.Std,
        "skewness": chaospy.Skew,
        "kurtosis": lambda p, d: chaospy.Kurt(p, d, fisher=False),
    }
    for name, oracle in expected.items():
        assert float(getattr(ours, name)) == pytest.approx(float(oracle(polynomial, joint)), rel=1e-9), name
    first, total = chaospy.Sens_m(polynomial, joint), chaospy.Sens_t(polynomial, joint)
    assert [float(ours.sobol(name)) for name in "ab"] == pytest.approx(first, rel=1e-8)
    assert [float(ours.total_sobol(name)) for name in "ab"] == pytest.approx(total, rel=1e-8)


def test_covariance_and_correlation_of_outputs():
    expanded = al.expand(lambda m: {"x": 2 * m["a"] + m["b"], "y": m["a"] - m["b"], "z": jnp.ones(3)}, MODEL)
    assert float(expanded.covariance("x", "y")) == pytest.approx(2 / 12 - 0.25, rel=1e-10)
    correlation = (2 / 12 - 0.25) / np.sqrt((4 / 12 + 0.25) * (1 / 12 + 0.25))
    assert float(expanded.correlation("x", "y")) == pytest.approx(correlation, rel=1e-10)
    with pytest.raises(al.ProblemError, match="different shapes"):
        expanded.covariance("x", "z")


def kinked(m):
    return {"y": jnp.abs(m["a"] - 0.3) + 0.2 * m["b"], "a": m["a"]}


# Each kind of tail is a program that takes long to compile: by default quantiles alone.
@pytest.mark.parametrize("first", [6, pytest.param(None, marks=pytest.mark.slow)], ids=["some", "every"])
def test_statistics_over_elements_are_those_of_a_large_sample(first):
    pieces = al.expand(kinked, MODEL, al.MultiElement(order=3, error=1e-3))
    generator = np.random.default_rng(7)
    a, b = generator.uniform(size=400_000), generator.normal(0.0, 0.5, 400_000)
    y = np.abs(a - 0.3) + 0.2 * b
    # What is asked, what samples say, and how far these are off.
    asked = [
        (lambda one: one.skewness["y"], stats.skew(y), 2e-2),
        (lambda one: one.kurtosis["y"], stats.kurtosis(y, fisher=False), 3e-2),
        (lambda one: one.covariance("y", "a"), np.cov(y, a)[0, 1], 2e-3),
        (lambda one: one.correlation("y", "a"), np.corrcoef(y, a)[0, 1], 6e-3),
        (lambda one: one["y"].quantile(0.05), np.quantile(y, 0.05), 4e-3),
        (lambda one: one["y"].quantile(0.95), np.quantile(y, 0.95), 4e-3),
        (lambda one: one["y"].probability(above=0.5), np.mean(y > 0.5), 3e-3),
        (lambda one: one["y"].conditional_value_at_risk(0.9), y[y > np.quantile(y, 0.9)].mean(), 4e-3),
    ]
    for ask, expected, accuracy in asked[:first]:
        np.testing.assert_allclose(ask(pieces), expected, atol=accuracy)


@pytest.mark.slow
def test_shapes_that_change_with_every_point_are_warned_of_and_others_are_not(recwarn):
    gamma = al.expand(lambda model: jnp.exp(-model["x"]), {"x": al.Gamma(shape=0.6, scale=2.0)}, al.Expansion(8))
    # SciPy's kurtosis, of a million quantiles, is 1.58.
    assert gamma.leave_one_out < 0.05
    assert not recwarn
    with pytest.warns(al.ExpansionWarning, match=r"Kurt\[output\] of the expansion is 2.*by the jackknife"):
        assert float(gamma.kurtosis) > 1e5
    normal = al.expand(lambda model: jnp.exp(0.5 * model["x"]), {"x": al.Normal(0.0, 1.0)}, al.Expansion(6))
    skewness, kurtosis = stats.lognorm(0.5).stats("sk")
    assert float(normal.skewness) == pytest.approx(skewness, rel=1e-3)
    assert float(normal.kurtosis) == pytest.approx(3 + kurtosis, rel=1e-3)
    assert not recwarn
