"""Quantiles, probabilities, conditional value at risk, density and distribution: SciPy's distributions, far into the
tails.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special, stats
from small_expansions import basis_of, coefficients_of_polynomial, prepare

import aleator as al
from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.statistics import (
    ConditionalValueAtRisk,
    Probability,
    Quantile,
    cdf,
    lines_through,
    pdf,
)
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm


def value(statistic, coefficients, basis):
    return np.asarray(statistic.of(np.asarray(coefficients), prepare([statistic], basis).of(statistic)))


ORDER = 4  # of every basis of one variable: they share their programs
DISTRIBUTIONS = {
    "normal": (HermiteGerm(), stats.norm()),
    "uniform": (LegendreGerm(), stats.uniform(-1, 2)),
    "beta": (JacobiGerm(2.0, 5.0), stats.beta(2, 5, -1, 2)),
    "gamma": (LaguerreGerm(3.0), stats.gamma(3)),
    "gamma with an infinite density": (LaguerreGerm(0.6), stats.gamma(0.6)),
}


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_tails_of_one_variable_are_those_of_its_distribution(distribution):
    germ, oracle = DISTRIBUTIONS[distribution]
    basis = basis_of([germ], ORDER)
    coefficients = coefficients_of_polynomial(basis, lambda a: 1.0 - 2.0 * a)
    for level in (1e-4, 0.1, 0.5, 0.99, 1 - 1e-4):
        exact = 1 - 2 * oracle.ppf(1 - level)
        assert value(Quantile(level), coefficients, basis) == pytest.approx(exact, abs=3e-8 * oracle.std() / level)
        assert value(Probability(below=exact), coefficients, basis) == pytest.approx(level, abs=1e-8)


def test_a_function_that_is_not_monotone_is_integrated_over_every_interval():
    # a^2 of a normal is chi-square; a^3 - a of a uniform crosses zero three times.
    basis = basis_of([HermiteGerm()], ORDER)
    squared = coefficients_of_polynomial(basis, lambda a: a**2)
    for threshold in (0.1, 4.0, 20.0):
        expected = stats.chi2(1).cdf(threshold)
        assert value(Probability(below=threshold), squared, basis) == pytest.approx(expected, abs=1e-8)
    basis = basis_of([LegendreGerm()], ORDER)
    cubic = coefficients_of_polynomial(basis, lambda a: a**3 - a / 4)
    assert value(Probability(above=0.0), cubic, basis) == pytest.approx(0.5, abs=1e-12)
    roots = np.sort(np.roots([1, 0, -0.25, -0.02]).real)
    assert value(Probability(below=0.02), cubic, basis) == pytest.approx(
        (roots[0] + 1 + roots[2] - roots[1]) / 2, abs=1e-9
    )


def test_tails_of_a_linear_function_of_normals_are_right_to_the_ppm():
    basis = basis_of([HermiteGerm()] * 2, 2)
    coefficients = coefficients_of_polynomial(basis, lambda a, b: 3 + a - 2 * b)
    distribution = stats.norm(3, np.sqrt(5))
    for rejects in (0.5, 1e-2, 1e-6):
        limit = distribution.isf(rejects)
        assert value(Probability(above=limit), coefficients, basis) == pytest.approx(rejects, rel=1e-4)
        assert value(Quantile(1 - rejects), coefficients, basis) == pytest.approx(limit, rel=1e-5)
        beyond = np.sqrt(5) * stats.norm.pdf(stats.norm.isf(rejects)) / rejects
        assert value(ConditionalValueAtRisk(1 - rejects), coefficients, basis) == pytest.approx(3 + beyond, rel=1e-6)
        lower = ConditionalValueAtRisk(rejects, lower=True)
        assert value(lower, coefficients, basis) == pytest.approx(3 - beyond, rel=1e-6)


def test_tails_on_two_sides_and_around_are_those_of_closed_forms():
    """A product of two normals is as often below a number as above its negative (SciPy's K0), a sum of squares is
    chi-square.
    """
    basis = basis_of([HermiteGerm()] * 2, 2)
    product = coefficients_of_polynomial(basis, lambda a, b: a * b)
    squares = coefficients_of_polynomial(basis, lambda a, b: a**2 + b**2)
    for size in (5.0, 9.0):
        exact = integrate.quad(lambda x: special.k0(x) / np.pi, size, 60, epsabs=0)[0]
        assert value(Probability(above=size), product, basis) == pytest.approx(exact, rel=1e-4)
        assert value(Probability(below=-size), product, basis) == pytest.approx(exact, rel=1e-4)
    assert value(Probability(above=25.0), squares, basis) == pytest.approx(np.exp(-12.5), rel=5e-3)
    mean_beyond = 2 - 2 * np.log(1e-4)
    assert value(ConditionalValueAtRisk(1 - 1e-4), squares, basis) == pytest.approx(mean_beyond, rel=1e-4)


@pytest.mark.parametrize("variables", [5])
def test_tails_of_sums_of_exponential_numbers_are_within_what_their_error_says(variables):
    inputs = {f"x{i}": al.Gamma(shape=1.0, scale=1.0) for i in range(variables)}
    expanded = al.expand(lambda at: sum(at.values()), inputs, al.Expansion(order=1))
    gamma, lines = stats.gamma(variables), lines_through(expanded.basis)
    for chance in (1e-3, 1e-7):
        for kind in (Probability(above=gamma.isf(chance)), Probability(below=gamma.ppf(chance))):
            estimate, error = map(float, kind.estimated(expanded.coefficients, lines))
            assert abs(estimate - chance) < max(error, 0.02 * chance)


def test_a_median_between_two_extremes_is_found():
    """Of x^4 - 3 x^2 of a normal x: the roots of the polynomial give its distribution function."""
    basis = basis_of([HermiteGerm()], ORDER)
    found = float(value(Quantile(0.5), coefficients_of_polynomial(basis, lambda x: x**4 - 3 * x**2), basis))
    inner, outer = (np.sqrt((3 + sign * np.sqrt(9 + 4 * found)) / 2) for sign in (-1, 1))
    assert 2 * (stats.norm.cdf(outer) - stats.norm.cdf(inner)) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.slow
def test_density_and_cdf_are_those_of_the_distribution_and_of_each_entry():
    basis = basis_of([HermiteGerm()] * 2, 2)
    single = np.asarray(coefficients_of_polynomial(basis, lambda a, b: 1 + 3 * a + 4 * b))
    path, values = np.stack([single, 2 * single], axis=1), np.linspace(-20.0, 20.0, 9)
    levels, density = (np.asarray(one(values, path, lines_through(basis))) for one in (cdf, pdf))
    for k, distribution in enumerate((stats.norm(1, 5), stats.norm(2, 10))):
        assert levels[:, k] == pytest.approx(distribution.cdf(values), abs=1e-8)
        assert density[:, k] == pytest.approx(distribution.pdf(values), abs=1e-6)


def test_of_equal_directions_rounding_chooses_none():
    """A shift moves the last digits of all coefficients, and a quantile by itself alone, else no search ends."""
    basis = basis_of([HermiteGerm()] * 4, 2)
    shifts = np.linspace(-16.0, 16.0, 9)
    rows = [
        coefficients_of_polynomial(basis, lambda a, b, c, d, by=by: by + a**2 + b**2 + c**2 + d**2) for by in shifts
    ]
    moved = np.array([float(value(Quantile(0.99), one, basis)) for one in rows]) - shifts
    assert moved == pytest.approx(stats.chi2(4).ppf(0.99), abs=0.05)
    assert np.ptp(moved) < 1e-9


def test_along_a_path_the_distance_from_the_mean_is_interpolated_in_standard_deviations():
    # A spread that begins at zero, and a skew shape.
    basis, t = basis_of([HermiteGerm()], 2), np.linspace(0.0, np.pi, 8 * 30 + 1)
    shape = np.asarray(coefficients_of_polynomial(basis, lambda a: a + 0.2 * a**2))
    path = np.outer(shape, np.sin(t)) + np.outer(np.eye(len(shape))[0], np.cos(t))
    z = stats.norm.ppf(0.99)
    lines, exact = lines_through(basis), np.cos(t) + np.sin(t) * (z + 0.2 * z**2)
    found = Quantile(0.99).along(np.stack([path, path], axis=-1), lines, 8)
    near = exact > exact.max() - 0.4
    assert found[near, 1] == pytest.approx(exact[near], abs=1e-6)
    assert found[:9, 0] == pytest.approx(exact[:9], abs=0.02)
    lost = np.where(np.arange(len(t)) == 100, np.nan, path)
    assert np.flatnonzero(np.isnan(Quantile(0.99).along(lost, lines, 8))).tolist() == [100]


def test_without_uncertain_variables_the_output_is_its_own_quantile():
    basis = Basis({}, np.zeros((1, 0), dtype=int))
    assert value(Quantile(0.9), jnp.array([2.0]), basis) == 2.0


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


def test_thresholds_and_levels_that_make_no_event_are_refused():
    with pytest.raises(ProblemError, match="received neither"):
        Probability()
    with pytest.raises(ProblemError, match="above < below"):
        Probability(above=2.0, below=1.0)
    with pytest.raises(ProblemError, match="Quantile"):
        Quantile(1.0)


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
    expanded = al.expand(lambda at: at["x"], {"x": tent}, al.Expansion(ORDER))
    assert float(expanded.quantile(0.9)) == pytest.approx(1 - np.sqrt(0.2), rel=1e-6)


def test_beside_a_gap_in_a_density_probabilities_and_quantiles_are_exact():
    """An interpolation across the gap must not swing about it."""

    def blocks(x):
        return np.where(x < 1, 0.9, np.where(x < 9, 0.0, 0.1))

    expanded = al.expand(lambda at: at["x"], {"x": al.Density(blocks, 0.0, 10.0)}, al.Expansion(1))
    for place, above in ((0.9, 0.19), (9.1, 0.09), (9.2, 0.08), (9.5, 0.05), (9.9, 0.01)):
        assert expanded.probability(above=place) == pytest.approx(above, rel=2e-6)
    for level, place in ((0.8, 0.8 / 0.9), (0.92, 9.2), (0.95, 9.5)):
        assert expanded.quantile(level) == pytest.approx(place, rel=1e-6)


def test_in_the_gap_of_a_density_errors_cover_what_its_table_misses():
    part = 0.01
    modes = al.Density(lambda x: (1 - part) * stats.norm.pdf(x) + part * stats.norm.pdf(x, 8, 0.05), -9.0, 9.0)
    basis = basis_of([modes.germ()], 1)
    lines, identity = prepare([Quantile(0.5)], basis).of(Quantile(0.5)), coefficients_of_polynomial(basis, lambda x: x)
    for kind, exact in ((Probability(above=7.0), part), (Quantile(0.9905), 8 + 0.05 * stats.norm.ppf(0.05))):
        estimate, error = (float(one) for one in kind.estimated(identity, lines))
        assert estimate == pytest.approx(exact, abs=error)
    far, error = Probability(above=1.0).estimated(identity, lines)
    assert float(far) == pytest.approx((1 - part) * stats.norm.sf(1.0) + part, abs=1e-8)
    assert float(error) == 0.0


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
