"""Mean, standard deviation and variance: exact values, convergence, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from aleator.expansion import Expansion, collocate
from aleator.statistics import Mean, Std, Variance
from aleator.uncertainty import Beta, Decision, Gamma, Normal, Uniform, placements, realise
from compiling import compiled


def mean(coefficients):
    return Mean().of(coefficients, ())


def variance(coefficients):
    return Variance().of(coefficients, ())


def std(coefficients):
    return Std().of(coefficients, ())


def coefficients_of(model, output, order, decisions=(), points=None):
    collocation = collocate(placements(model).germs, Expansion(order, points=points)).collocation
    x = jnp.asarray(decisions, dtype=float)
    samples = jax.vmap(lambda xi: output(realise(model, xi, x)))
    return collocation.coefficients((samples if len(decisions) else compiled(samples))(collocation.points))


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
        numbers = float(location) + float(scale) * np.asarray(collocation.points[:, 0])
        powers = np.stack([numbers, numbers**2, numbers**3], axis=1)
        means, variances, spreads = map(np.asarray, moments_of(collocation.coefficients(powers)))
        first, second = ([moment_of(oracle, n * power) for power in (1, 2, 3)] for n in (1, 2))
        assert means == pytest.approx(first, rel=1e-10)
        assert variances == pytest.approx(np.array(second) - np.square(first), rel=1e-9)
        assert spreads == pytest.approx(np.sqrt(variances), rel=1e-14)


def test_a_shared_number_is_fully_correlated_with_itself_and_unshared_ones_are_independent():
    distribution = Uniform(0.0, half_width=1.0)
    for one, expected in ((distribution.shared("x"), 4 / 3), (distribution, 2 / 3)):
        coefficients = coefficients_of({"a": one, "b": one}, lambda m: m["a"] + m["b"], order=2)
        assert float(variance(coefficients)) == pytest.approx(expected, rel=1e-12)


DECAY = {"b": Uniform.bounds(0.1, 0.2), "u": Normal(1.5, 0.2)}


def decays_moment(power):
    """E[u^k] E[exp(-k b t)], the second factor by quadrature."""
    over_b = integrate.quad(lambda b: np.exp(-10.0 * power * b) / 0.1, 0.1, 0.2, epsabs=0, epsrel=1e-13)[0]
    return stats.norm(1.5, 0.2).moment(power) * over_b


MEAN, VARIANCE = decays_moment(1), decays_moment(2) - decays_moment(1) ** 2


def test_moments_of_the_uncertain_decay_converge_exponentially_with_the_order():
    orders = np.array([1, 4, 7])
    found = []
    for order in orders:
        collocation = collocate(placements(DECAY).germs, Expansion(int(order))).collocation
        b, u = np.asarray(collocation.points).T
        coefficients = collocation.coefficients((1.5 + 0.2 * u) * np.exp(-10.0 * (0.15 + 0.05 * b)))
        found.append([float(coefficients[0]), float(np.sum(np.square(coefficients[1:])))])
    errors = np.abs(np.array(found) / [MEAN, VARIANCE] - 1)
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


MODEL = {
    "b": Uniform(Decision(0.15), half_width=Decision(0.05, 0.0)),
    "c": Gamma(mean=2.0, std=Decision(0.4, 0.01, 1.0)),
    "g": Beta(alpha=Decision(2.0, 0.5, 9.0), beta=5.0),
    "u": Normal(Decision(1.5), Decision(0.2, 0.0)),
}


def response(model):
    return model["u"] * jnp.exp(-4.0 * model["b"]) + model["c"] ** 2 * model["g"]


def exact_moments(x):
    """Independence and one-dimensional quadrature give the moments of the response."""
    centre, width, spread, alpha, mu, sigma = x
    k = (2.0 / spread) ** 2
    distributions = stats.uniform(centre - width, 2 * width), stats.gamma(k, scale=2.0 / k), stats.beta(alpha, 5.0)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    decays = [weights @ np.exp(-4.0 * power * (centre + width * nodes)) / 2 for power in (1, 2)]
    u = stats.norm(mu, sigma)
    first = [u.mean() * decays[0], distributions[1].moment(2) * distributions[2].mean()]
    second = [u.moment(2) * decays[1], distributions[1].moment(4) * distributions[2].moment(2)]
    return sum(first), sum(s - f**2 for s, f in zip(second, first, strict=True))


def central_difference(function, x):
    steps = np.diag(1e-4 * np.asarray(x))
    return np.stack([(function(x + step) - function(x - step)) / (2 * step.max()) for step in steps], axis=-1)


@pytest.mark.slow
def test_derivatives_of_mean_and_std_through_the_decisions_are_those_of_finite_differences_and_of_exact_moments():
    def both(x):
        coefficients = coefficients_of(MODEL, response, order=4, decisions=x)
        return jnp.stack([mean(coefficients), std(coefficients)])

    program = compiled(lambda x: (both(x), jax.jacfwd(both)(x), jax.jacrev(both)(x)))
    x = np.array([0.15, 0.05, 0.4, 2.0, 1.5, 0.2])  # b.mean, b.half_width, c.std, g.alpha, u.mean, u.std
    values, forward, reverse = map(np.asarray, program(x))
    assert forward == pytest.approx(central_difference(lambda x: np.asarray(program(x)[0]), x), rel=1e-6, abs=1e-8)
    assert reverse == pytest.approx(forward, rel=1e-10)
    exact_mean, exact_variance = exact_moments(x)
    assert values == pytest.approx([exact_mean, np.sqrt(exact_variance)], rel=1e-4)
    expected = central_difference(lambda x: np.array([exact_moments(x)[0], np.sqrt(exact_moments(x)[1])]), x)
    assert forward == pytest.approx(expected, rel=4e-3, abs=1e-4)
