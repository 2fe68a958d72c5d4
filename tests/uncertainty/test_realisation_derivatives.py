"""Numbers at decisions or traced parameters against SciPy's quantiles; their first and second derivatives.

The families whose quantiles take no iteration share one program.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, special, stats

import aleator as al
from aleator.uncertainty import placements, realise
from compiling import compiled

LEVELS = np.array([0.01, 0.2, 0.5, 0.83, 0.99])


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


MOMENTS = {
    "mean": al.Decision(2.0, 1.0, 4.0),
    "std": al.Decision(1.0, 0.1, 2.0),
    "lower": al.Decision(0.5, -1.0, 0.9),
}

# distribution, SciPy's distribution at decisions, decisions away from the start
QUICK = {
    "uniform": (
        al.Uniform(al.Decision(5.0), half_width=al.Decision(1.0, 0.0)),
        lambda m, h: stats.uniform(m - h, 2 * h),
        [5.5, 1.7],
    ),
    "normal": (al.Normal(al.Decision(1.0), al.Decision(0.5, 0.0)), stats.norm, [1.2, 0.8]),
    "lognormal by moments": (al.LogNormal(**MOMENTS), lognormal_by_moments, [2.4, 0.8, 0.3]),
    "weibull": (
        al.Weibull(al.Decision(2.0, 0.0), al.Decision(1.5, 0.2, 5.0), lower=al.Decision(1.0)),
        lambda s, k, low: stats.weibull_min(k, low, s),
        [2.4, 0.8, 0.5],
    ),
    "weibull by moments": (al.Weibull(**MOMENTS), weibull_by_moments, [2.4, 0.8, 0.3]),
    "triangular": (
        al.Triangular(al.Decision(1.0, 0.5, 1.8), al.Decision(2.0, 1.8, 3.0), al.Decision(4.0, 3.0, 5.0)),
        lambda low, mode, up: stats.triang((mode - low) / (up - low), low, up - low),
        [1.2, 2.6, 4.4],
    ),
    "truncated normal": (
        al.TruncatedNormal(
            al.Decision(2.0, 1.0, 3.0),
            al.Decision(0.5, 0.2, 2.0),
            lower=al.Decision(1.2, 1.0, 2.0),
            upper=al.Decision(3.5, 3.0, 9.0),
        ),
        truncated_normal,
        [2.2, 0.8, 1.5, 3.1],
    ),
}

# the same, each in a program of its own, at several decisions: shapes below 1 and large ones too
ITERATED = {
    "beta": (
        al.Beta(
            alpha=al.Decision(2.0, 0.1, 200.0),
            beta=al.Decision(5.0, 0.1, 200.0),
            lower=al.Decision(-1.0, -2.0, 1.0),
            upper=al.Decision(3.0, 1.0, 4.0),
        ),
        lambda a, b, low, up: stats.beta(a, b, low, up - low),
        [[1.4, 6.0, -0.5, 3.5], [0.3, 0.6, -1.0, 2.0], [90.0, 140.0, 0.1, 1.5]],
    ),
    "gamma by moments": (al.Gamma(**MOMENTS), gamma_by_moments, [[2.4, 0.8, 0.3], [1.2, 1.6, 0.1], [3.9, 0.2, 0.5]]),
}


def central_difference(function, x):
    """Derivatives of an array by each entry of `x`, last axis, of fourth order: their error is about 1e-11."""
    x, columns = np.asarray(x, dtype=float), []
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = h = 1e-3 * abs(x[i])
        near, far = (function(x + k * step) - function(x - k * step) for k in (1, 2))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=-1)


def germs_of(distribution, levels=LEVELS):
    return np.asarray(distribution.germ().quantile(levels))[:, None]


def numbers_at(distribution, germs, x):
    """The numbers at all germ points, at once."""
    return jax.vmap(lambda xi: realise(distribution, xi, x))(jnp.asarray(germs))


def values_and_slopes(distribution, germs, x):
    """Values and Jacobian of one trace."""
    slopes, values = jax.jacfwd(lambda x: (numbers_at(distribution, germs, x),) * 2, has_aux=True)(x)
    return values, slopes


def agree_with_scipy(oracle, x, values, slopes):
    assert np.asarray(values) == pytest.approx(oracle(*x).ppf(LEVELS), rel=1e-9), x
    expected = central_difference(lambda x: oracle(*x).ppf(LEVELS), x)
    # An entry may be far smaller than its row, where the differences are no better than that.
    allowed = 1e-6 * np.abs(expected) + 1e-8 * np.abs(expected).max(axis=1, keepdims=True) + 1e-12
    assert (np.abs(np.asarray(slopes) - expected) <= allowed).all(), (x, slopes, expected)


def test_numbers_and_slopes_by_decisions_are_those_of_scipys_quantile_at_the_level_of_the_germ():
    germs = {name: germs_of(distribution) for name, (distribution, *_) in QUICK.items()}
    program = compiled(lambda at: {name: values_and_slopes(QUICK[name][0], germs[name], x) for name, x in at.items()})
    starts = {name: placements(distribution).vector("initial") for name, (distribution, *_) in QUICK.items()}
    for at in (starts, {name: np.array(moved) for name, (*_, moved) in QUICK.items()}):
        found = program(at)
        for name, (_, oracle, _) in QUICK.items():
            agree_with_scipy(oracle, at[name], *found[name])


@pytest.mark.parametrize(("distribution", "oracle", "places"), ITERATED.values(), ids=ITERATED.keys())
def test_numbers_and_slopes_of_betas_and_gammas_are_those_of_scipys_quantile(distribution, oracle, places):
    germs = germs_of(distribution)
    program = compiled(lambda x: values_and_slopes(distribution, germs, x))
    for x in (placements(distribution).vector("initial"), *map(np.array, places)):
        agree_with_scipy(oracle, x, *program(x))


# a distribution of one shape parameter, its value, SciPy's distribution
SHAPES = {
    "beta": (lambda s: al.Beta(alpha=s, beta=5.0), 2.0, lambda s: stats.beta(s, 5.0)),
    "weibull": (lambda s: al.Weibull(1.0, s), 2.2, lambda s: stats.weibull_min(s)),
    "triangular": (lambda s: al.Triangular(0.0, s, 1.0), 0.3, lambda s: stats.triang(s)),
    "lognormal": (lambda s: al.LogNormal(median=1.0, log_std=s), 0.3, lambda s: stats.lognorm(s)),
}


def first_and_second_difference(function, x, relative_step=2e-2):
    """Of sixth order."""
    h = relative_step * abs(x)
    values = np.array([function(x + k * h) for k in (-3, -2, -1, 0, 1, 2, 3)])
    first, second = np.array([-1, 9, -45, 0, 45, -9, 1]), np.array([2, -27, 270, -490, 270, -27, 2])
    return first @ values / (60 * h), second @ values / (180 * h**2)


@pytest.mark.parametrize(
    "names",
    [("weibull", "triangular", "lognormal"), pytest.param(("beta",), marks=pytest.mark.slow)],
    ids=lambda names: names[0],
)
def test_first_and_second_derivatives_by_decided_and_by_traced_shapes_are_those_of_scipy(names):
    levels = np.array([0.02, 0.6, 0.995])

    def numbers(name, shape, germs):
        """The numbers by a decision and by a traced shape; and the latter added up, for derivatives in reverse."""
        make, start, _ = SHAPES[name]
        decided = make(al.Decision(start, 0.8 * start, 1.25 * start))
        return numbers_at(decided, germs, shape[None]), jax.vmap(make(shape).value)(germs[:, 0])

    def twice(name, shape, germs):
        def once(shape):
            both = jax.jacfwd(lambda s: numbers(name, s, germs))(shape)
            return both, both

        second, first = jax.jacfwd(once, has_aux=True)(shape)
        return first, second, jax.grad(lambda s: numbers(name, s, germs)[1].sum())(shape)

    germs = {name: jnp.asarray(germs_of(SHAPES[name][0](SHAPES[name][1]), levels)) for name in names}
    program = compiled(lambda shapes: {name: twice(name, shapes[name], germs[name]) for name in names})
    found = program({name: np.array(SHAPES[name][1]) for name in names})
    for name in names:
        _, shape, oracle = SHAPES[name]
        expected = first_and_second_difference(lambda s, oracle=oracle: oracle(s).ppf(levels), shape)
        first, second, reverse = found[name]
        for by_decision_or_traced in range(2):
            assert np.asarray(first[by_decision_or_traced]) == pytest.approx(expected[0], rel=1e-6, abs=1e-8)
            assert np.asarray(second[by_decision_or_traced]) == pytest.approx(expected[1], rel=1e-5, abs=1e-7)
        assert float(reverse) == pytest.approx(float(np.sum(first[1])), rel=1e-10)
