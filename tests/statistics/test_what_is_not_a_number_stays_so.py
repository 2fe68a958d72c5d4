"""A coefficient or a sample that is not a number, or infinite, makes no statistic that looks like one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, prepare, random_coefficients

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
    Variance,
    root,
)
from aleator.uncertainty import LegendreGerm
from compiling import compiled

BOUNDED = basis_of([LegendreGerm()] * 2, 2)
OF_SAMPLES = [
    *(Variance(), Std(), Skewness(), Kurtosis(), Covariance(), Correlation(), CornishFisher(0.9), Quantile(0.9)),
    *(Probability(above=0.1), Probability(above=-0.5, below=0.5), ConditionalValueAtRisk(0.9), Supremum()),
]


def shape_of(statistic):
    return (3, 2) if isinstance(statistic, Covariance | Correlation) else (3,)


def test_one_value_of_a_sample_that_is_no_number_spoils_its_own_entry_and_no_other():
    samples = {shape: np.random.default_rng(0).normal(size=(20, *shape)) for shape in ((3,), (3, 2))}
    for values in samples.values():
        values[4, 1] = np.nan
    of_samples = compiled(lambda samples: [one.of_sample(samples[shape_of(one)]) for one in OF_SAMPLES])
    for statistic, found in zip(OF_SAMPLES, of_samples(samples), strict=True):
        assert np.isnan(found).tolist() == [False, True, False], statistic


def test_one_value_has_no_spread_and_numpy_says_nothing_of_it():
    values = {shape: np.arange(1.0, 1.0 + np.prod(shape)).reshape(1, *shape) for shape in ((3,), (3, 2))}
    for statistic in (Variance(), Std(), Covariance()):
        assert np.isnan(statistic.of_sample(values[shape_of(statistic)])).all(), statistic
    # Half the squared difference is the variance of two.
    assert float(Variance().of_sample(np.array([1.0, 4.0]))) == 4.5


PLAIN = (Std(), Variance(), Skewness(), Kurtosis(), Correlation(), Sobol("a"), Sobol("b", total=True))


def test_what_is_no_number_or_infinite_spoils_its_entry_and_what_is_constant_has_derivative_zero():
    constants = prepare(PLAIN, BOUNDED)

    def each(coefficients):
        return [one.of(coefficients[shape_of(one)], constants.of(one)) for one in PLAIN]

    def single(coefficients):
        return jnp.stack([one.of(coefficients, constants.of(one)) for one in PLAIN if shape_of(one) == (3,)])

    @compiled
    def program(coefficients, still, at):
        roots = jax.vmap(root)(at), jax.grad(root)(0.0), jax.grad(jax.grad(root))(0.0)
        return each(coefficients), single(still), jax.jacrev(single)(still), roots

    at = np.array([np.nan, -1e-18, -0.0, 0.0, 9.0, np.inf])
    still = np.array([3.0] + [0.0] * (BOUNDED.terms - 1))
    for bad in (np.nan, np.inf):
        coefficients = {shape: np.array(random_coefficients(BOUNDED, shape=shape)) for shape in ((3,), (3, 2))}
        for entries in coefficients.values():
            entries[2, 1] = bad
        found, values, slopes, (roots, slope, curvature) = jax.tree.map(np.asarray, program(coefficients, still, at))
        for statistic, entries in zip(PLAIN, found, strict=True):
            if bad != bad or not isinstance(statistic, Std | Variance):  # these are infinite
                assert np.isnan(entries).tolist() == [False, True, False], statistic
        assert (np.asarray(values) == 0.0).all()
        assert (np.asarray(slopes) == 0.0).all()
        np.testing.assert_array_equal(roots, [np.nan, 0.0, 0.0, 0.0, 3.0, np.inf])
        assert (slope, curvature) == (0.0, 0.0)


def test_an_expansion_that_is_no_number_does_not_pass_for_resolved():
    expanded = al.expand(lambda m: m["x"] ** 2, {"x": al.Uniform(1.0, half_width=0.1)}, al.Expansion(order=2))
    spoilt = eqx.tree_at(lambda one: one.coefficients, expanded, np.asarray(expanded.coefficients) * np.nan)
    assert np.isnan(spoilt.highest_degree_share)


traced_spread = jax.jit(lambda values: Std().of(values, ()))


@pytest.mark.parametrize(
    ("coefficients", "exact"),
    [
        ([1.0, 3.0, 4.0], 5.0),
        ([1.0, 1e-9, 0.0], 1e-9),
        ([1.0, 1e-14, 0.0], 0.0),
        ([1e170, 1e150, 0.0], 0.0),
        ([1e180, 1e180, 0.0], np.inf),
        ([np.inf, np.inf, 0.0], np.inf),
        ([np.inf, np.nan, 0.0], np.nan),
    ],
)
def test_a_spread_that_overflows_is_none_of_rounding(coefficients, exact):
    for of in (lambda values: Std().of(values, ()), traced_spread):
        np.testing.assert_allclose(np.asarray(of(np.array(coefficients))), exact, rtol=1e-12)
