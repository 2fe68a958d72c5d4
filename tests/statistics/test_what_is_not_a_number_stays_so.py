"""A coefficient or a sample that is not a number, or infinite, makes no statistic that looks like one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, random_coefficients

import aleator as al
from aleator.statistics import (
    ConditionalValueAtRisk,
    CornishFisher,
    Correlation,
    Covariance,
    Kurtosis,
    Probability,
    Quantile,
    Skewness,
    Sobol,
    Std,
    Supremum,
    TotalSobol,
    Variance,
    _lines,
    prepare,
    root,
)
from aleator.uncertainty import HermiteGerm, LegendreGerm
from compiling import compiled

BASES = {"bounded": basis_of([LegendreGerm()] * 2, 2), "normal": basis_of([HermiteGerm()] * 2, 2)}
OF_SAMPLES = [
    *(Variance(), Std(), Skewness(), Kurtosis(), Covariance(), Correlation(), CornishFisher(0.9), Quantile(0.9)),
    *(Probability(above=0.1), Probability(above=-0.5, below=0.5), ConditionalValueAtRisk(0.9), Supremum()),
]
STATISTICS = [*OF_SAMPLES, Sobol("a"), TotalSobol("b")]


@pytest.fixture(autouse=True)
def few_lines(monkeypatch):
    monkeypatch.setattr(_lines, "_LINES", 2**8)


def shape_of(statistic):
    return (3, 2) if isinstance(statistic, Covariance | Correlation) else (3,)


# Normal variables have no supremum.
CASES = [
    (one, distribution)
    for distribution in BASES
    for one in STATISTICS
    if distribution == "bounded" or not isinstance(one, Supremum)
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statistic", "distribution"), CASES, ids=lambda one: one if isinstance(one, str) else one.text("y")
)
def test_one_coefficient_that_is_no_number_spoils_its_own_entry_and_no_other(statistic, distribution):
    basis = BASES[distribution]
    coefficients = random_coefficients(basis, shape=shape_of(statistic))
    constants = prepare([statistic], basis).of(statistic)
    found = np.asarray(compiled(lambda c: statistic.of(c, constants))(coefficients.at[2, 1].set(jnp.nan)))
    np.testing.assert_array_equal(np.isnan(found), [False, True, False])


@pytest.mark.parametrize("statistic", OF_SAMPLES, ids=lambda one: one.text("y"))
def test_one_value_of_a_sample_that_is_no_number_spoils_its_own_entry_and_no_other(statistic):
    values = jnp.asarray(np.random.default_rng(0).normal(size=(20, *shape_of(statistic)))).at[4, 1].set(jnp.nan)
    np.testing.assert_array_equal(np.isnan(statistic.of_sample(values)), [False, True, False])


@pytest.mark.parametrize(
    "statistic", [Skewness(), Kurtosis(), Correlation(), Sobol("a")], ids=lambda one: one.text("y")
)
def test_an_infinite_spread_does_not_pass_for_none(statistic):
    basis = BASES["bounded"]
    coefficients = random_coefficients(basis, shape=shape_of(statistic)).at[2, 1].set(jnp.inf)
    assert np.isnan(statistic.of(coefficients, prepare([statistic], basis).of(statistic))[1])


def test_the_root_keeps_what_is_no_number_and_takes_rounding_below_zero_for_zero():
    found = root(jnp.array([jnp.nan, -1e-18, -0.0, 0.0, 9.0, jnp.inf]))
    np.testing.assert_array_equal(found, [np.nan, 0.0, 0.0, 0.0, 3.0, np.inf])


def test_the_root_and_the_shares_of_what_is_constant_have_derivative_zero():
    assert float(jax.grad(root)(0.0)) == 0.0
    assert float(jax.grad(jax.grad(root))(0.0)) == 0.0
    basis = BASES["bounded"]
    still = jnp.zeros(basis.terms).at[0].set(3.0)
    for statistic in (Std(), Skewness(), Kurtosis(), Sobol("a"), TotalSobol("b")):
        constants = prepare([statistic], basis).of(statistic)
        value, slope = jax.value_and_grad(lambda c, one=statistic, k=constants: one.of(c, k))(still)
        assert float(value) == 0.0
        np.testing.assert_array_equal(slope, np.zeros(basis.terms))


def test_an_expansion_that_is_no_number_does_not_pass_for_resolved():
    expanded = al.expand(lambda m: m["x"] ** 2, {"x": al.Uniform(1.0, half_width=0.1)}, al.Expansion(order=2))
    spoilt = eqx.tree_at(lambda one: one.coefficients, expanded, expanded.coefficients * jnp.nan)
    assert np.isnan(spoilt.highest_degree_share)
