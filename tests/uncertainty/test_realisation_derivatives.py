"""Realisation with decided parameters against scipy's quantiles, and its derivatives against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, special, stats

from aleator.expansion import Expansion, collocate
from aleator.uncertainty import (
    Beta,
    Decision,
    Density,
    Exponential,
    Gamma,
    Gumbel,
    LogNormal,
    Normal,
    Toleranced,
    Triangular,
    TruncatedNormal,
    Uniform,
    Weibull,
    placements,
    realise,
)
from compiling import compiled

LEVELS = [0.01, 0.2, 0.5, 0.83, 0.99]


def beta_by_moments(mean, std, lower=0.0, upper=1.0):
    m, v = (mean - lower) / (upper - lower), (std / (upper - lower)) ** 2
    alpha = m**2 * (1 - m) / v - m
    return stats.beta(alpha, alpha * (1 - m) / m, lower, upper - lower)


def gamma_by_moments(mean, std, lower=0.0):
    return stats.gamma(((mean - lower) / std) ** 2, lower, std**2 / (mean - lower))


def lognormal_by_moments(mean, std, lower=0.0):
    variance = np.log(1 + (std / (mean - lower)) ** 2)
    return stats.lognorm(variance**0.5, lower, (mean - lower) / np.exp(variance / 2))


def weibull_by_moments(mean, std, lower=0.0):
    def excess(shape):
        return special.gamma(1 + 2 / shape) / special.gamma(1 + 1 / shape) ** 2 - 1 - (std / (mean - lower)) ** 2

    shape = optimize.brentq(excess, 0.3, 50.0, xtol=1e-14)
    return stats.weibull_min(shape, lower, (mean - lower) / special.gamma(1 + 1 / shape))


def truncated_normal(location, scale, lower=-np.inf, upper=np.inf):
    return stats.truncnorm((lower - location) / scale, (upper - location) / scale, location, scale)


# model, scipy's distribution at given decisions, decisions away from the start
CASES = {
    "uniform by half-width": (
        Uniform(Decision(5.0), half_width=Decision(1.0, 0.0)),
        lambda m, h: stats.uniform(m - h, 2 * h),
        [5.5, 1.7],
    ),
    "uniform by std": (
        Uniform(Decision(5.0), std=Decision(1.0, 0.0)),
        lambda m, s: stats.uniform(m - s * 3**0.5, 2 * s * 3**0.5),
        [4.0, 0.3],
    ),
    "uniform by bounds": (
        Uniform.bounds(Decision(1.0, -5.0, 1.6), Decision(2.0, 1.6)),
        lambda a, b: stats.uniform(a, b - a),
        [1.4, 2.2],
    ),
    "normal": (Normal(Decision(1.0), Decision(0.5, 0.0)), lambda m, s: stats.norm(m, s), [1.2, 0.8]),
    "beta by shape": (
        Beta(alpha=Decision(2.0, 0.5, 9.0), beta=Decision(5.0, 0.5, 9.0)),
        lambda a, b: stats.beta(a, b),
        [3.1, 4.0],
    ),
    "beta by shape with everything decided": (
        Beta(
            alpha=Decision(2.0, 0.5, 9.0),
            beta=Decision(5.0, 0.5, 9.0),
            lower=Decision(-1.0, -2.0, 1.0),
            upper=Decision(3.0, 1.0, 4.0),
        ),
        lambda a, b, low, up: stats.beta(a, b, low, up - low),
        [1.4, 6.0, -0.5, 3.5],
    ),
    "beta with small shapes": (
        Beta(alpha=Decision(0.4, 0.1, 1.0), beta=Decision(0.5, 0.1, 1.0)),
        lambda a, b: stats.beta(a, b),
        [0.3, 0.6],
    ),
    "beta with large shapes": (
        Beta(alpha=Decision(80.0, 10.0, 200.0), beta=Decision(150.0, 10.0, 200.0)),
        lambda a, b: stats.beta(a, b),
        [90.0, 140.0],
    ),
    "beta with decided bounds alone": (
        Beta(alpha=2.0, beta=5.0, lower=Decision(-1.0, upper=1.0), upper=Decision(3.0, 1.0)),
        lambda low, up: stats.beta(2.0, 5.0, low, up - low),
        [-0.3, 2.0],
    ),
    "beta by moments": (Beta(mean=Decision(0.3, 0.1, 0.9), std=Decision(0.1, 0.01, 0.2)), beta_by_moments, [0.4, 0.12]),
    "beta by moments with everything decided": (
        Beta(
            mean=Decision(3.0, 2.5, 4.0),
            std=Decision(0.7, 0.1, 1.0),
            lower=Decision(1.0, 0.5, 1.2),
            upper=Decision(6.0, 5.5, 7.0),
        ),
        beta_by_moments,
        [3.2, 0.6, 0.8, 6.5],
    ),
    "gamma by shape": (
        Gamma(shape=Decision(4.0, 0.5, 9.0), scale=Decision(0.5, 0.0)),
        lambda k, s: stats.gamma(k, scale=s),
        [3.0, 0.6],
    ),
    "gamma with a small shape": (Gamma(shape=Decision(0.6, 0.1, 1.0), scale=1.0), lambda k: stats.gamma(k), [0.4]),
    "gamma with a large shape": (
        Gamma(shape=Decision(200.0, 50.0, 500.0), scale=1.0),
        lambda k: stats.gamma(k),
        [230.0],
    ),
    "gamma with decided scale and bound": (
        Gamma(shape=2.0, scale=Decision(0.5, 0.0), lower=Decision(1.0)),
        lambda s, low: stats.gamma(2.0, low, s),
        [0.7, -1.0],
    ),
    "gamma by moments with everything decided": (
        Gamma(mean=Decision(2.0, 1.0, 4.0), std=Decision(1.0, 0.1, 2.0), lower=Decision(0.5, -1.0, 0.9)),
        gamma_by_moments,
        [2.4, 0.8, 0.3],
    ),
    "exponential by mean": (
        Exponential(mean=Decision(2.0, 1.0, 4.0), lower=Decision(0.5, -1.0, 0.9)),
        lambda m, low: stats.expon(low, m - low),
        [2.4, 0.3],
    ),
    "exponential by rate": (Exponential(rate=Decision(2.0, 1.0, 4.0)), lambda r: stats.expon(0, 1 / r), [2.4]),
    "lognormal by moments with everything decided": (
        LogNormal(mean=Decision(2.0, 1.0, 4.0), std=Decision(1.0, 0.1, 2.0), lower=Decision(0.5, -1.0, 0.9)),
        lognormal_by_moments,
        [2.4, 0.8, 0.3],
    ),
    "lognormal by median": (
        LogNormal(median=Decision(2.0, 1.0, 4.0), log_std=Decision(0.5, 0.1, 2.0)),
        lambda m, s: stats.lognorm(s, 0, m),
        [2.4, 0.8],
    ),
    "lognormal by logarithms": (
        LogNormal(log_mean=Decision(0.5, -1.0, 4.0), log_std=Decision(0.5, 0.1, 2.0), lower=1.0),
        lambda m, s: stats.lognorm(s, 1.0, np.exp(m)),
        [0.4, 0.8],
    ),
    "weibull by shape with everything decided": (
        Weibull(Decision(2.0, 0.0), Decision(1.5, 0.5, 5.0), lower=Decision(1.0)),
        lambda s, k, low: stats.weibull_min(k, low, s),
        [2.4, 2.2, 0.5],
    ),
    "weibull with a small shape": (Weibull(1.0, Decision(0.6, 0.2, 5.0)), lambda k: stats.weibull_min(k), [0.4]),
    "weibull by moments with everything decided": (
        Weibull(mean=Decision(2.0, 1.0, 4.0), std=Decision(1.0, 0.1, 2.0), lower=Decision(0.5, -1.0, 0.9)),
        weibull_by_moments,
        [2.4, 0.8, 0.3],
    ),
    "gumbel": (Gumbel(Decision(1.0), Decision(0.2, 0.0)), lambda m, s: stats.gumbel_r(m, s), [1.2, 0.3]),
    "gumbel by moments": (
        Gumbel(mean=Decision(1.0), std=Decision(0.2, 0.0)),
        lambda m, s: stats.gumbel_r(m - np.euler_gamma * s * 6**0.5 / np.pi, s * 6**0.5 / np.pi),
        [1.2, 0.3],
    ),
    "triangular with everything decided": (
        Triangular(Decision(1.0, 0.5, 1.8), Decision(2.0, 1.8, 3.0), Decision(4.0, 3.0, 5.0)),
        lambda low, mode, up: stats.triang((mode - low) / (up - low), low, up - low),
        [1.2, 2.6, 4.4],
    ),
    "triangular and symmetric": (
        Triangular(mean=Decision(1.0), half_width=Decision(0.2, 0.0)),
        lambda m, h: stats.triang(0.5, m - h, 2 * h),
        [1.2, 0.3],
    ),
    "truncated normal with everything decided": (
        TruncatedNormal(
            Decision(2.0, 1.0, 3.0),
            Decision(0.5, 0.2, 2.0),
            lower=Decision(1.2, 1.0, 2.0),
            upper=Decision(3.5, 3.0, 9.0),
        ),
        truncated_normal,
        [2.2, 0.8, 1.5, 3.1],
    ),
    "truncated normal on one side": (
        TruncatedNormal(Decision(2.0, 1.0, 3.0), Decision(0.5, 0.2, 2.0), lower=Decision(1.2, 1.0, 2.0)),
        truncated_normal,
        [2.2, 0.8, 1.5],
    ),
    "truncated normal in its tail": (
        TruncatedNormal(0.0, Decision(1.0, 0.8, 2.0), lower=Decision(6.0, 5.0, 7.0), upper=9.0),
        lambda s, low: truncated_normal(0.0, s, low, 9.0),
        [1.1, 5.8],
    ),
    "a density": (
        Density(lambda x: np.exp(-(x**2) / 2), -np.inf, np.inf, location=Decision(1.0), scale=Decision(0.2, 0.0)),
        lambda m, s: stats.norm(m, s),
        [1.2, 0.3],
    ),
    "toleranced": (
        Toleranced(27.645, tolerance=Decision(0.05, 0.0, 0.2), cp=Decision(1.0, 0.5, 2.0)),
        lambda t, cp: stats.norm(27.645, t / 3 / cp),
        [0.06, 1.3],
    ),
    "toleranced, off centre": (
        Toleranced(Decision(5.0), plus=Decision(0.05, 0.0, 0.2), minus=0.02, cp=1.33, cpk=1.0, towards="lower"),
        lambda m, p: stats.norm(m + p / 2 - 0.01 - (0.33 / 1.33) * (p + 0.02) / 2, (p + 0.02) / 6 / 1.33),
        [5.5, 0.06],
    ),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    return request.param


def central_difference(function, x):
    """Fourth-order central differences: their error, about 1e-11, is far below the tolerance of 1e-6."""
    x, gradient = np.asarray(x, dtype=float), np.empty(len(x))
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = h = 1e-3 * abs(x[i])
        near, far = (function(x + k * step) - function(x - k * step) for k in (1, 2))
        gradient[i] = (8 * near - far) / (12 * h)
    return gradient


def realised(distribution, x):
    """The numbers at all levels, at once."""
    germs = jnp.asarray(distribution.germ().quantile(np.array(LEVELS)))[:, None]
    return jax.vmap(lambda xi: realise(distribution, xi, x))(germs)


def test_realisation_is_the_quantile_of_the_current_distribution_at_the_level_of_the_germ(case):
    distribution, oracle, decided = case
    numbers = compiled(lambda x: realised(distribution, x))
    for x in (placements(distribution).vector("initial"), np.array(decided)):
        assert numbers(x) == pytest.approx(oracle(*x).ppf(LEVELS), rel=1e-9)


@pytest.mark.slow
def test_derivatives_by_decisions_are_those_of_scipys_quantile_at_fixed_probability(case):
    distribution, oracle, decided = case
    exact = compiled(jax.jacfwd(lambda x: realised(distribution, x)))(jnp.array(decided))
    for row, level in zip(np.asarray(exact), LEVELS, strict=True):
        expected = central_difference(lambda x, level=level: oracle(*x).ppf(level), decided)
        assert row == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.max(np.abs(expected)) + 1e-15)


@pytest.mark.parametrize(
    "name",
    [
        "uniform by bounds",
        "beta by moments",
        "gamma by moments with everything decided",
    ],
)
def test_reverse_and_forward_derivatives_agree_compiled_or_not(name):
    distribution, _, decided = CASES[name]
    xi = jnp.asarray(distribution.germ().quantile(np.array([0.3])))
    number, x = (lambda x: realise(distribution, xi, x)), jnp.array(decided)
    forward = jax.jacfwd(number)(x)
    assert jax.grad(number)(x) == pytest.approx(np.asarray(forward), rel=1e-12)
    assert compiled(jax.grad(number))(x) == pytest.approx(np.asarray(forward), rel=1e-9)


@pytest.mark.parametrize(
    "name", ["beta by shape", "beta with small shapes", "gamma by shape", "normal", "weibull with a small shape"]
)
def test_derivatives_by_the_germ_are_those_of_scipys_quantile(name):
    distribution, oracle, decided = CASES[name]
    along_levels = np.array([0.4])
    by_level = central_difference(lambda level: oracle(*decided).ppf(level[0]), along_levels)
    germ_by_level = central_difference(lambda level: distribution.germ().quantile(level)[0], along_levels)
    xi = jnp.asarray(distribution.germ().quantile(along_levels))
    exact = compiled(jax.grad(lambda xi: realise(distribution, xi, jnp.array(decided))))(xi)
    assert exact == pytest.approx(by_level / germ_by_level, rel=1e-6)


def test_moments_after_a_change_of_shape_are_those_of_the_new_distribution_by_quadrature():
    distribution = Gamma(mean=Decision(2.0, 1.0, 4.0), std=Decision(1.0, 0.1, 2.0))
    nodes, weights = distribution.germ().gauss(40)
    values = jax.vmap(lambda xi: realise(distribution, xi[None], jnp.array([2.5, 0.9])))(jnp.asarray(nodes))
    assert float(weights @ values) == pytest.approx(2.5, rel=1e-5)
    assert float(weights @ (values - 2.5) ** 2) == pytest.approx(0.81, rel=1e-4)


def test_the_germ_and_the_collocation_matrix_do_not_depend_on_the_decisions_values():
    distribution = Beta(mean=Decision(0.3, 0.1, 0.9), std=Decision(0.1, 0.01, 0.2))
    fixed = Beta(mean=0.3, std=0.1)
    assert distribution.germ() == fixed.germ()
    decided, constant = (collocate({"x": one.germ()}, Expansion(4)).collocation for one in (distribution, fixed))
    assert np.array_equal(decided.matrix, constant.matrix)
    # what moves with the decisions is the sample, exactly by scipy's quantile of the new distribution at the same
    # points
    levels = stats.beta(fixed.germ().alpha, fixed.germ().beta, -1, 2).cdf(np.asarray(decided.points[:, 0]))
    moved = jax.vmap(lambda xi: realise(distribution, xi, jnp.array([0.5, 0.05])))(decided.points)
    assert moved == pytest.approx(beta_by_moments(0.5, 0.05).ppf(levels), rel=1e-9)
