"""Moments, shapes, joint statistics and Sobol indices of expansions against closed forms and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats
from small_expansions import basis_of, coefficients_of_polynomial, prepare, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Expansion, collocate
from aleator.statistics import CornishFisher, Correlation, Covariance, Kurtosis, Mean, Skewness, Sobol, Std, Variance
from aleator.statistics import _shape as shape_module
from aleator.statistics._shape import square
from aleator.uncertainty import (
    Beta,
    Gamma,
    HermiteGerm,
    JacobiGerm,
    LaguerreGerm,
    LegendreGerm,
    Normal,
    Uniform,
    placements,
    realise,
)
from compiling import compiled
from zoo import cases


def mean(coefficients):
    return Mean().of(coefficients, ())


def variance(coefficients):
    return Variance().of(coefficients, ())


def std(coefficients):
    return Std().of(coefficients, ())


DISTRIBUTIONS = {
    "uniform": (Uniform(2.0, half_width=0.5), stats.uniform(1.5, 1)),
    "normal": (Normal(1.5, 0.2), stats.norm(1.5, 0.2)),
    "beta": (Beta(alpha=2.0, beta=5.0, lower=-1, upper=2), stats.beta(2, 5, -1, 3)),
    "gamma": (Gamma(shape=3.0, scale=0.5), stats.gamma(3, scale=0.5)),
}


moments_of = compiled(lambda coefficients: (mean(coefficients), variance(coefficients), std(coefficients)))


def moment_of(distribution, power):
    """By quadrature: scipy's `moment` keeps only eight digits of a distribution that is shifted."""
    return integrate.quad(lambda x: x**power * distribution.pdf(x), *distribution.support(), epsabs=0, epsrel=1e-12)[0]


def test_moments_of_powers_are_exact_in_an_expansion_of_their_degree():
    for ours, oracle in DISTRIBUTIONS.values():
        collocation = collocate({"x": ours.germ()}, Expansion(3)).collocation
        location, scale, _ = ours.canonical()
        numbers = float(location) + float(scale) * np.asarray(collocation.points)[:, 0]
        powers = np.stack([numbers, numbers**2, numbers**3], axis=1)
        means, variances, spreads = map(np.asarray, moments_of(collocation.coefficients(powers)))
        first, second = ([moment_of(oracle, n * power) for power in (1, 2, 3)] for n in (1, 2))
        assert means == pytest.approx(first, rel=1e-10)
        assert variances == pytest.approx(np.array(second) - np.square(first), rel=1e-9)
        assert spreads == pytest.approx(np.sqrt(variances), rel=1e-14)


def test_a_shared_number_is_fully_correlated_with_itself_and_unshared_ones_are_independent():
    distribution = Uniform(0.0, half_width=1.0)
    for one, expected in ((distribution.shared("x"), 4 / 3), (distribution, 2 / 3)):
        model = {"a": one, "b": one}
        collocation = collocate(placements(model).germs, Expansion(2)).collocation
        samples = compiled(jax.vmap(lambda xi, m=model: sum(realise(m, xi, np.zeros(0)).values())))(collocation.points)
        assert float(variance(collocation.coefficients(samples))) == pytest.approx(expected, rel=1e-12)


def test_a_certain_output_has_no_spread_and_does_not_disturb_derivatives_of_others():
    coefficients = np.zeros((3, 2))
    coefficients[1, 1], coefficients[2, 1] = 3.0, 4.0
    spreads, reverse, forward = compiled(lambda c: (std(c), jax.jacrev(std)(c), jax.jacfwd(std)(c)))(coefficients)
    assert spreads.tolist() == [0.0, 5.0]
    expected = np.zeros((2, 3, 2))
    expected[1, 1:, 1] = 3 / 5, 4 / 5
    for slopes in (reverse, forward):
        assert np.asarray(slopes) == pytest.approx(expected, rel=1e-14)


# --- Skewness, kurtosis, Cornish-Fisher quantile, covariance and correlation ------------------------------------------


def value(statistic, coefficients, basis):
    return np.asarray(statistic.of(np.asarray(coefficients), prepare([statistic], basis).of(statistic)))


@pytest.mark.parametrize("order", cases([8, 2]))
def test_skewness_and_kurtosis_of_a_distribution_are_those_of_scipy_at_any_order(order):
    germs = [(LegendreGerm(), stats.uniform(-1, 2)), (JacobiGerm(2.0, 5.0), stats.beta(2, 5, -1, 2))]
    germs += [(HermiteGerm(), stats.norm()), (LaguerreGerm(3.0), stats.gamma(3))]
    for germ, oracle in germs:
        basis = basis_of([germ], order)
        coefficients = coefficients_of_polynomial(basis, lambda a: 3.0 * a - 1.0)
        skewness, excess = oracle.stats("sk")
        assert value(Skewness(), coefficients, basis) == pytest.approx(float(skewness), rel=1e-9, abs=1e-9)
        assert value(Kurtosis(), coefficients, basis) == pytest.approx(3 + float(excess), rel=1e-9)


def test_a_sum_of_squared_normals_has_the_skewness_and_kurtosis_of_chi_square():
    basis = basis_of([HermiteGerm()] * 4, 2)
    coefficients = coefficients_of_polynomial(basis, lambda *x: sum(one**2 for one in x))
    assert value(Skewness(), coefficients, basis) == pytest.approx(np.sqrt(2), rel=1e-10)
    assert value(Kurtosis(), coefficients, basis) == pytest.approx(6, rel=1e-10)


def test_many_instants_are_the_same_as_each_alone_and_a_constant_has_no_shape():
    basis = basis_of([LegendreGerm(), HermiteGerm()], 3)
    path = np.array(random_coefficients(basis, shape=(70, 2)))
    path[:, 0, 0] = [3.0] + [0.0] * (basis.terms - 1)
    kinds = [Skewness(), Kurtosis(), CornishFisher(0.99)]
    constants = prepare(kinds, basis)

    def each(c):
        return [one.of(c, constants.of(one)) for one in kinds]

    both = compiled(lambda c: (each(c), each(c[:, 69, 1]), jax.jacrev(each)(c[:, 0, 0])))(path)
    together, alone, slopes = jax.tree.map(np.asarray, both)
    for values, single, expected in zip(together, alone, (0.0, 0.0, 3.0), strict=True):
        assert values.shape == (70, 2)
        assert float(values[69, 1]) == pytest.approx(float(single), rel=1e-12)
        assert float(values[0, 0]) == expected
    assert all(np.isfinite(slope).all() for slope in slopes)


@pytest.mark.slow
def test_the_cornish_fisher_quantile_is_exact_for_a_normal_distribution_and_close_for_a_skewed_one():
    basis = basis_of([HermiteGerm()], 3)
    normal = coefficients_of_polynomial(basis, lambda a: 2 + 3 * a)
    assert value(CornishFisher(0.999), normal, basis) == pytest.approx(stats.norm(2, 3).ppf(0.999), rel=1e-12)
    gamma = basis_of([LaguerreGerm(20.0)], 1)
    skewed = coefficients_of_polynomial(gamma, lambda a: a)
    assert value(CornishFisher(0.99), skewed, gamma) == pytest.approx(stats.gamma(20).ppf(0.99), rel=1e-3)


def test_statistics_of_a_sample_are_those_of_scipy():
    sample = np.random.default_rng(0).gamma(2.0, size=(500, 3))
    both = np.stack([sample[:, 0], sample[:, 1] + sample[:, 0]], axis=-1)
    found = [
        Skewness().of_sample(sample),
        Kurtosis().of_sample(sample),
        Covariance().of_sample(both),
        Correlation().of_sample(both),
    ]
    expected = stats.skew(sample), stats.kurtosis(sample, fisher=False), np.cov(both.T)[0, 1], np.corrcoef(both.T)[0, 1]
    for one, oracle in zip(found, expected, strict=True):
        assert np.asarray(one) == pytest.approx(oracle, rel=1e-12)


def test_a_square_too_large_for_the_memory_is_refused_with_a_remedy(monkeypatch):
    monkeypatch.setattr(shape_module, "_MOST_PRODUCTS", 100)
    with pytest.raises(ProblemError, match="lower order or a sparser index set"):
        square(basis_of([HermiteGerm()] * 3, 3))


def test_covariance_and_correlation_are_those_of_the_closed_form():
    # Cov[a + b, a^2 + 2 b] for a uniform on [-1, 1] and b standard normal: E[a a^2] = 0, so that 2 Var[b] is left.
    basis = basis_of([LegendreGerm(), HermiteGerm()], 2)
    first = coefficients_of_polynomial(basis, lambda a, b: a + b)
    second = coefficients_of_polynomial(basis, lambda a, b: a**2 + 2 * b)
    first, second = np.asarray(first), np.asarray(second)
    steady = 1e-17 * second
    steady[0] = 0.1
    columns = [first, first, 0 * first, steady], [second, -3 * first, first, first]
    pairs = np.stack([np.stack(column, 1) for column in columns], axis=-1)
    joint = [jax.vmap(one.of, in_axes=(1, None)) for one in (Covariance(), Correlation())]
    covariances, correlations, slopes = compiled(
        lambda c: (joint[0](c, ()), joint[1](c, ()), jax.jacrev(lambda c: joint[1](c, ()))(c))
    )(pairs)
    assert np.asarray(covariances)[0] == pytest.approx(2.0, rel=1e-12)
    variances = 1 / 3 + 1, 1 / 5 - 1 / 9 + 4
    # The last ones are with certain outputs, whose spread is nothing or rounding.
    assert np.asarray(correlations) == pytest.approx([2 / np.sqrt(np.prod(variances)), -1.0, 0.0, 0.0], rel=1e-12)
    assert np.isfinite(slopes).all()


# --- Sobol indices from coefficients ----------------------------------------------------------------------------------


def ishigami():
    """`sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1`, uniform between -pi and pi."""
    germs = {"x1": LegendreGerm(), "x2": LegendreGerm(), "x3": LegendreGerm()}
    basis, collocation = collocate(germs, Expansion(14))
    x1, x2, x3 = np.pi * np.asarray(collocation.points).T
    samples = np.sin(x1) + 7 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)
    return collocation.coefficients(samples), basis


INDICES = {
    Sobol("x1"): 0.3139051912,
    Sobol(("x2",)): 0.4424111448,
    Sobol("x3"): 0.0,
    Sobol(("x3", "x1")): 0.2436836641,
    Sobol(("x1", "x2")): 0.0,
    Sobol(("x1", "x2", "x3")): 0.0,
    Sobol("x1", total=True): 0.3139051912 + 0.2436836641,
    Sobol("x2", total=True): 0.4424111448,
    Sobol("x3", total=True): 0.2436836641,
}


def test_indices_of_ishigamis_function_are_the_published_ones():
    coefficients, basis = ishigami()
    for index, published in INDICES.items():
        assert value(index, coefficients, basis) == pytest.approx(published, abs=1e-6), index


def test_an_output_that_does_not_vary_has_zero_indices():
    basis = basis_of([LegendreGerm()], 2)
    assert value(Sobol("a"), jnp.array([3.0, 0.0, 0.0]), basis) == 0.0


def test_an_unknown_variable_is_refused_with_close_matches():
    basis = collocate({"mass": LegendreGerm(), "damping": HermiteGerm()}, Expansion(2)).basis
    for index in (Sobol(("damping", "mas")), Sobol("mas", total=True)):
        with pytest.raises(ProblemError, match=r"no germ variable 'mas'\. Did you mean 'mass'"):
            prepare([index], basis)
