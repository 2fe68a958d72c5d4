"""Skewness, kurtosis, Cornish-Fisher quantile, covariance and correlation: closed forms and chaospy."""

import jax
import numpy as np
import pytest
from scipy import stats
from small_expansions import basis_of, coefficients_of_polynomial, prepare, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.statistics import CornishFisher, Correlation, Covariance, Kurtosis, Skewness
from aleator.statistics import _shape as shape_module
from aleator.statistics._shape import square
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled
from zoo import cases


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
    pairs = np.stack([np.stack([first, first, 0 * first], 1), np.stack([second, -3 * first, first], 1)], axis=-1)
    joint = [jax.vmap(one.of, in_axes=(1, None)) for one in (Covariance(), Correlation())]
    covariances, correlations, slopes = compiled(
        lambda c: (joint[0](c, ()), joint[1](c, ()), jax.jacrev(lambda c: joint[1](c, ()))(c))
    )(pairs)
    assert np.asarray(covariances)[0] == pytest.approx(2.0, rel=1e-12)
    variances = 1 / 3 + 1, 1 / 5 - 1 / 9 + 4
    # The last is with a certain output.
    assert np.asarray(correlations) == pytest.approx([2 / np.sqrt(np.prod(variances)), -1.0, 0.0], rel=1e-12)
    assert np.isfinite(slopes).all()


def test_a_basis_without_variables_has_statistics():
    basis = Basis({}, np.zeros((1, 0), dtype=int))
    assert value(Kurtosis(), np.array([2.0]), basis) == 0.0
