"""Mean, standard deviation and variance: exact values and convergence."""

import jax
import numpy as np
import pytest
from scipy import integrate, stats

from aleator.expansion import Expansion, collocate
from aleator.statistics import Mean, Std, Variance
from aleator.uncertainty import Beta, Gamma, Normal, Uniform, placements, realise
from compiling import compiled


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


DECAY = {"b": Uniform.bounds(0.1, 0.2), "u": Normal(1.5, 0.2)}


def decays_moment(power):
    """E[u^k] E[exp(-k b t)], the second factor by quadrature."""
    over_b = integrate.quad(lambda b: np.exp(-10.0 * power * b) / 0.1, 0.1, 0.2, epsabs=0, epsrel=1e-13)[0]
    return stats.norm(1.5, 0.2).moment(power) * over_b


def test_moments_of_the_uncertain_decay_converge_exponentially_with_the_order():
    exact = [decays_moment(1), decays_moment(2) - decays_moment(1) ** 2]
    orders, found = np.array([1, 4, 7]), []
    for order in orders:
        collocation = collocate(placements(DECAY).germs, Expansion(int(order))).collocation
        b, u = np.asarray(collocation.points).T
        values = (1.5 + 0.2 * u) * np.exp(-10.0 * (0.15 + 0.05 * b))
        coefficients = np.asarray(collocation.coefficients(values))
        found.append([float(coefficients[0]), float(np.sum(coefficients[1:] ** 2))])
    errors = np.abs(np.array(found) / exact - 1)
    assert (-np.polyfit(orders, np.log10(errors), 1)[0] > 1).all()
    assert (errors[-1] < 1e-7).all()
    assert found[-1] == pytest.approx([float(mean(coefficients)), float(variance(coefficients))], rel=1e-12)


def test_a_certain_output_has_no_spread_and_does_not_disturb_derivatives_of_others():
    coefficients = np.zeros((3, 2))
    coefficients[1, 1], coefficients[2, 1] = 3.0, 4.0
    spreads, reverse, forward = compiled(lambda c: (std(c), jax.jacrev(std)(c), jax.jacfwd(std)(c)))(coefficients)
    assert spreads.tolist() == [0.0, 5.0]
    expected = np.zeros((2, 3, 2))
    expected[1, 1:, 1] = 3 / 5, 4 / 5
    for slopes in (reverse, forward):
        assert np.asarray(slopes) == pytest.approx(expected, rel=1e-14)
