"""Quantiles, probabilities, conditional value at risk, density and distribution: SciPy's distributions, far into the
tails.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats
from small_expansions import basis_of, coefficients_of_polynomial, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.statistics import ConditionalValueAtRisk, Probability, Quantile, cdf, lines_through, pdf, prepare
from aleator.statistics._crossings import extrema, horner, roots_between
from aleator.statistics._line_distribution import finite_ends, line_distribution
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled

of = compiled(lambda statistic, coefficients, constants: statistic.of(coefficients, constants))


def value(statistic, coefficients, basis):
    return np.asarray(of(statistic, coefficients, prepare([statistic], basis).of(statistic)))


DISTRIBUTIONS = {
    "normal": (HermiteGerm(), stats.norm()),
    "uniform": (LegendreGerm(), stats.uniform(-1, 2)),
    "beta": (JacobiGerm(2.0, 5.0), stats.beta(2, 5, -1, 2)),
    "arcsine": (JacobiGerm(0.5, 0.5), stats.beta(0.5, 0.5, -1, 2)),
    "gamma": (LaguerreGerm(3.0), stats.gamma(3)),
    "gamma with an infinite density": (LaguerreGerm(0.6), stats.gamma(0.6)),
}


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_partial_moments_of_tabulated_distributions_are_those_of_the_special_functions(distribution):
    germ, oracle = DISTRIBUTIONS[distribution]
    table = line_distribution([germ], 3)
    levels = np.array([1e-6, 0.01, 0.2, 0.5, 0.77, 0.999, 1 - 1e-6])
    low, high = finite_ends(germ)
    x = (2 * oracle.ppf(levels) - low - high) / (high - low)
    moments = np.asarray(table.partial_moments(jnp.asarray(x)[:, None, None], 3))[:, 0, 0]
    assert moments[:, 0] == pytest.approx(levels, abs=2e-9)

    def integrand(level, k):
        return germ.polynomials(2, germ.quantile(np.array([level])))[0, k]

    for k in (1, 2):
        expected = [integrate.quad(integrand, 0, level, args=(k,), epsabs=1e-11)[0] for level in levels[:5]]
        assert moments[:5, k] == pytest.approx(np.array(expected), abs=1e-8)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_quantiles_and_probabilities_of_one_variable_are_those_of_its_distribution(distribution):
    germ, oracle = DISTRIBUTIONS[distribution]
    basis = basis_of([germ], 3)
    coefficients = coefficients_of_polynomial(basis, lambda a: 1.0 - 2.0 * a)
    for level in (1e-4, 0.1, 0.5, 0.99, 1 - 1e-4):
        exact = 1 - 2 * oracle.ppf(1 - level)
        assert value(Quantile(level), coefficients, basis) == pytest.approx(exact, abs=3e-8 * oracle.std() / level)
        assert value(Probability(below=exact), coefficients, basis) == pytest.approx(level, abs=1e-8)
        assert value(Probability(above=exact), coefficients, basis) == pytest.approx(1 - level, abs=1e-8)


def test_a_function_that_is_not_monotone_is_integrated_over_every_interval():
    # a^2 of a normal is chi-square; a^3 - a of a uniform crosses zero three times.
    basis = basis_of([HermiteGerm()], 2)
    squared = coefficients_of_polynomial(basis, lambda a: a**2)
    for threshold in (0.1, 1.0, 4.0, 20.0):
        expected = stats.chi2(1).sf(threshold)
        assert value(Probability(above=threshold), squared, basis) == pytest.approx(expected, abs=1e-8)
    basis = basis_of([LegendreGerm()], 3)
    cubic = coefficients_of_polynomial(basis, lambda a: a**3 - a / 4)
    assert value(Probability(above=0.0), cubic, basis) == pytest.approx(0.5, abs=1e-12)
    roots = np.sort(np.roots([1, 0, -0.25, -0.02]).real)
    assert value(Probability(below=0.02), cubic, basis) == pytest.approx(
        (roots[0] + 1 + roots[2] - roots[1]) / 2, abs=1e-9
    )


@pytest.mark.parametrize("rejects", [1e-2, 1e-4, 1e-6])
def test_rejects_of_a_linear_function_of_normals_are_right_to_the_ppm(rejects):
    basis = basis_of([HermiteGerm()] * 5, 2)
    weights = np.array([1.0, 0.5, 2.0, -1.5, 0.1])
    coefficients = coefficients_of_polynomial(basis, lambda *x: 3 + weights @ np.array(x))
    limit = stats.norm(3, np.linalg.norm(weights)).isf(rejects)
    assert value(Probability(above=limit), coefficients, basis) == pytest.approx(rejects, rel=1e-4)
    assert value(Quantile(1 - rejects), coefficients, basis) == pytest.approx(limit, rel=1e-5)


def test_rejects_of_a_nearly_linear_function_of_normals_are_right_to_a_percent():
    """A sum of independent quadratics: its exact distribution by one numerical convolution."""
    basis = basis_of([HermiteGerm()] * 2, 2)
    coefficients = coefficients_of_polynomial(basis, lambda a, b: a + b + 0.05 * b**2 - 0.03 * a**2)
    for limit in (3.5, 5.5, 7.0):
        # P[a - 0.03 a^2 > limit - b - 0.05 b^2], a between the two roots.
        def tail(b, limit=limit):
            left = limit - b - 0.05 * b**2
            half = np.sqrt(np.maximum(1 - 4 * 0.03 * left, 0)) / 0.06
            centre = 1 / 0.06
            inside = special.ndtr(centre + half) - special.ndtr(centre - half)
            return special.ndtr(half - centre) - special.ndtr(-half - centre) if half > 0 else 0.0 * inside

        exact = integrate.quad(lambda b: tail(b) * stats.norm.pdf(b), -8, 8, epsabs=0, epsrel=1e-9, limit=400)[0]
        assert value(Probability(above=limit), coefficients, basis) == pytest.approx(exact, rel=1e-2)


@pytest.mark.parametrize(("variables", "tolerance"), [(2, 1e-4), (3, 2e-3)])
def test_sums_of_uniform_numbers_follow_the_distribution_of_irwin_and_hall(variables, tolerance):
    basis = basis_of([LegendreGerm()] * variables, 2)
    coefficients = coefficients_of_polynomial(basis, lambda *x: sum((1 + one) / 2 for one in x))
    for threshold in np.array([0.2, 0.4, 0.6]) * variables:
        terms = [(-1) ** k * math.comb(variables, k) * (threshold - k) ** variables for k in range(int(threshold) + 1)]
        exact = sum(terms) / math.factorial(variables)
        assert value(Probability(below=threshold), coefficients, basis) == pytest.approx(exact, rel=tolerance)


def test_a_sum_of_a_normal_and_a_uniform_number_has_the_tails_of_their_convolution():
    basis = basis_of([LegendreGerm(), HermiteGerm()], 2)
    coefficients = coefficients_of_polynomial(basis, lambda a, b: a + b)
    for threshold in (1.0, 3.0, 5.0):
        # The integral of the normal distribution function over a uniform shift.
        def primitive(x):
            return -(x * stats.norm.sf(x) - stats.norm.pdf(x))

        exact = (primitive(threshold - 1) - primitive(threshold + 1)) / 2
        assert value(Probability(above=threshold), coefficients, basis) == pytest.approx(exact, rel=5e-3)


def test_conditional_value_at_risk_is_that_of_the_closed_forms():
    basis = basis_of([HermiteGerm()] * 3, 2)
    normal = coefficients_of_polynomial(basis, lambda a, b, c: 1 + 2 * a - b + 2 * c)
    for level in (0.5, 0.95, 0.9999):
        tail = 1 + 3 * stats.norm.pdf(stats.norm.ppf(level)) / (1 - level)
        assert value(ConditionalValueAtRisk(level), normal, basis) == pytest.approx(tail, rel=1e-6)
        lower = ConditionalValueAtRisk(1 - level, lower=True)
        assert value(lower, normal, basis) == pytest.approx(2 - tail, rel=1e-6)
    basis = basis_of([LaguerreGerm(1.0)], 3)
    exponential = coefficients_of_polynomial(basis, lambda a: a)
    # Without memory: the mean beyond a quantile is the quantile plus one.
    expected = stats.expon.ppf(0.9) + 1
    assert value(ConditionalValueAtRisk(0.9), exponential, basis) == pytest.approx(expected, rel=1e-7)


def test_density_and_cdf_are_those_of_the_distribution_and_of_each_entry():
    basis = basis_of([HermiteGerm()] * 2, 2)
    one = coefficients_of_polynomial(basis, lambda a, b: 1 + 3 * a + 4 * b)
    path = jnp.stack([one, 2 * one], axis=1)
    values, lines = jnp.linspace(-20.0, 20.0, 9), lines_through(basis)
    for k, distribution in enumerate((stats.norm(1, 5), stats.norm(2, 10))):
        assert np.asarray(compiled(cdf)(values, path, lines))[:, k] == pytest.approx(distribution.cdf(values), abs=1e-8)
        assert np.asarray(compiled(pdf)(values, path, lines))[:, k] == pytest.approx(distribution.pdf(values), abs=1e-6)


def test_the_density_integrates_to_one_and_the_quantile_inverts_the_distribution():
    basis = basis_of([LegendreGerm(), HermiteGerm(), JacobiGerm(2.0, 3.0)], 3)
    coefficients, lines = random_coefficients(basis, decay=0.2), lines_through(basis)
    values = jnp.linspace(-5.0, 5.0, 201)
    density = compiled(pdf)(values, coefficients, lines)
    assert float(jnp.trapezoid(density, values)) == pytest.approx(1.0, abs=1e-3)
    for level in (0.001, 0.4, 0.99):
        at = value(Quantile(level), coefficients, basis)
        assert float(compiled(cdf)(at[None], coefficients, lines)[0]) == pytest.approx(level, rel=1e-10)


def test_a_path_is_taken_entry_by_entry():
    basis = basis_of([HermiteGerm()], 3)
    path = random_coefficients(basis, shape=(40, 2), decay=0.1)
    together = value(Quantile(0.9), path, basis)
    assert together.shape == (40, 2)
    assert together[39, 1] == pytest.approx(value(Quantile(0.9), path[:, 39, 1], basis), rel=1e-12)


def test_a_certain_output_is_its_own_quantile_with_a_finite_derivative():
    basis = basis_of([LegendreGerm(), HermiteGerm()], 2)
    certain = jnp.zeros(basis.terms).at[0].set(3.0)
    for statistic in (Quantile(0.9), ConditionalValueAtRisk(0.9)):
        constants = prepare([statistic], basis).of(statistic)
        assert float(of(statistic, certain, constants)) == 3.0
        gradient = np.asarray(compiled(jax.grad(statistic.of))(certain, constants))
        assert np.all(np.isfinite(gradient))
        assert gradient[0] == pytest.approx(1.0)
    assert value(Probability(above=2.0), certain, basis) == 1.0
    assert value(Probability(above=4.0), certain, basis) == 0.0


def test_without_uncertain_variables_the_output_is_its_own_quantile():
    basis = Basis({}, np.zeros((1, 0), dtype=int))
    assert value(Quantile(0.9), jnp.array([2.0]), basis) == 2.0


def test_a_change_of_level_or_threshold_compiles_nothing():
    basis = basis_of([HermiteGerm()], 2)
    coefficients = random_coefficients(basis)
    traces = []

    @compiled
    def both(quantile, probability, constants):
        traces.append(1)
        return quantile.of(coefficients, constants), probability.of(coefficients, constants)

    for level, threshold in ((0.9, 1.0), (0.99, 2.0)):
        both(Quantile(level), Probability(above=threshold), lines_through(basis))
    assert len(traces) == 1


def test_statistics_of_a_sample_are_those_of_numpy():
    sample = np.random.default_rng(0).normal(size=(1000, 2))
    assert Quantile(0.9).of_sample(sample) == pytest.approx(np.quantile(sample, 0.9, axis=0), rel=1e-14)
    assert Probability(above=0.5, below=1.0).of_sample(sample) == pytest.approx(
        ((sample > 0.5) & (sample < 1)).mean(axis=0)
    )
    beyond = np.sort(sample, axis=0)
    assert ConditionalValueAtRisk(0.9).of_sample(sample) == pytest.approx(beyond[-100:].mean(axis=0), rel=5e-3)
    assert ConditionalValueAtRisk(0.1, lower=True).of_sample(sample) == pytest.approx(
        beyond[:100].mean(axis=0), rel=5e-3
    )


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, np.nan, "0.9", True])
def test_a_level_outside_of_0_to_1_is_refused(level):
    for kind in (Quantile, ConditionalValueAtRisk):
        with pytest.raises(ProblemError, match=kind.__name__):
            kind(level)


def test_thresholds_that_make_no_event_are_refused():
    with pytest.raises(ProblemError, match="received neither"):
        Probability()
    with pytest.raises(ProblemError, match="above < below"):
        Probability(above=2.0, below=1.0)
    with pytest.raises(ProblemError, match="one finite number"):
        Probability(above=np.inf)


def test_statistics_print_as_mathematics():
    assert Quantile(0.99).text("x") == "Q0.99[x]"
    assert ConditionalValueAtRisk(0.95).text("x") == "CVaR0.95[x]"
    assert Probability(above=3.0).text("x") == "P[x > 3]"
    assert Probability(above=1.0, below=3.0).text("x") == "P[1 < x < 3]"


def test_all_roots_of_polynomials_are_found_between_their_extrema():
    generator = np.random.default_rng(0)
    for degree in (1, 2, 5, 7):
        roots = np.sort(generator.uniform(-1.5, 1.5, (degree, 50)), axis=0)
        powers = jnp.asarray(np.stack([np.polynomial.polynomial.polyfromroots(one) for one in roots.T], axis=1))
        edges = compiled(extrema)(powers)
        found = compiled(roots_between)(powers, edges, horner(powers, edges))
        residuals = np.asarray(horner(powers, found))
        is_root = (np.asarray(found) > edges[:-1]) & (np.asarray(found) < edges[1:])
        assert is_root.sum(axis=0).tolist() == (np.abs(roots) < 1).sum(axis=0).tolist()
        assert np.abs(residuals[is_root]).max() < 1e-9
