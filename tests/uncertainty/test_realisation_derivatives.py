"""Numbers at decisions or traced parameters against SciPy's quantiles; their first and second derivatives.

The families whose quantiles take no iteration share one program: to compile is what takes long here.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, special, stats

from aleator._core.errors import ProblemError
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

LEVELS = np.array([0.01, 0.2, 0.5, 0.83, 0.99])
NONE = np.zeros(0)


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


MOMENTS = {
    "mean": Decision(2.0, 1.0, 4.0),
    "std": Decision(1.0, 0.1, 2.0),
    "lower": Decision(0.5, -1.0, 0.9),
}

# distribution, SciPy's distribution at decisions, decisions away from the start
QUICK = {
    "uniform": (
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
    "normal": (Normal(Decision(1.0), Decision(0.5, 0.0)), stats.norm, [1.2, 0.8]),
    "beta with decided bounds alone": (
        Beta(alpha=2.0, beta=5.0, lower=Decision(-1.0, upper=1.0), upper=Decision(3.0, 1.0)),
        lambda low, up: stats.beta(2.0, 5.0, low, up - low),
        [-0.3, 2.0],
    ),
    "gamma with decided scale and bound": (
        Gamma(shape=2.0, scale=Decision(0.5, 0.0), lower=Decision(1.0)),
        lambda s, low: stats.gamma(2.0, low, s),
        [0.7, -1.0],
    ),
    "exponential by mean": (
        Exponential(mean=Decision(2.0, 1.0, 4.0), lower=Decision(0.5, -1.0, 0.9)),
        lambda m, low: stats.expon(low, m - low),
        [2.4, 0.3],
    ),
    "exponential by rate": (Exponential(rate=Decision(2.0, 1.0, 4.0)), lambda r: stats.expon(0, 1 / r), [2.4]),
    "lognormal by moments": (LogNormal(**MOMENTS), lognormal_by_moments, [2.4, 0.8, 0.3]),
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
    "weibull": (
        Weibull(Decision(2.0, 0.0), Decision(1.5, 0.2, 5.0), lower=Decision(1.0)),
        lambda s, k, low: stats.weibull_min(k, low, s),
        [2.4, 0.8, 0.5],
    ),
    "weibull by moments": (Weibull(**MOMENTS), weibull_by_moments, [2.4, 0.8, 0.3]),
    "gumbel": (Gumbel(Decision(1.0), Decision(0.2, 0.0)), stats.gumbel_r, [1.2, 0.3]),
    "gumbel by moments": (
        Gumbel(mean=Decision(1.0), std=Decision(0.2, 0.0)),
        lambda m, s: stats.gumbel_r(m - np.euler_gamma * s * 6**0.5 / np.pi, s * 6**0.5 / np.pi),
        [1.2, 0.3],
    ),
    "triangular": (
        Triangular(Decision(1.0, 0.5, 1.8), Decision(2.0, 1.8, 3.0), Decision(4.0, 3.0, 5.0)),
        lambda low, mode, up: stats.triang((mode - low) / (up - low), low, up - low),
        [1.2, 2.6, 4.4],
    ),
    "triangular and symmetric": (
        Triangular(mean=Decision(1.0), half_width=Decision(0.2, 0.0)),
        lambda m, h: stats.triang(0.5, m - h, 2 * h),
        [1.2, 0.3],
    ),
    "truncated normal": (
        TruncatedNormal(
            Decision(2.0, 1.0, 3.0),
            Decision(0.5, 0.2, 2.0),
            lower=Decision(1.2, 1.0, 2.0),
            upper=Decision(3.5, 3.0, 9.0),
        ),
        truncated_normal,
        [2.2, 0.8, 1.5, 3.1],
    ),
    "truncated normal in its tail, on one side": (
        TruncatedNormal(0.0, Decision(1.0, 0.8, 2.0), lower=Decision(6.0, 5.0, 7.0)),
        lambda s, low: truncated_normal(0.0, s, low),
        [1.1, 5.8],
    ),
    "a density": (
        Density(lambda x: np.exp(-(x**2) / 2), -np.inf, np.inf, location=Decision(1.0), scale=Decision(0.2, 0.0)),
        stats.norm,
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

# the same, each in a program of its own, at several decisions: shapes below 1 and large ones too
ITERATED = {
    "beta": (
        Beta(
            alpha=Decision(2.0, 0.1, 200.0),
            beta=Decision(5.0, 0.1, 200.0),
            lower=Decision(-1.0, -2.0, 1.0),
            upper=Decision(3.0, 1.0, 4.0),
        ),
        lambda a, b, low, up: stats.beta(a, b, low, up - low),
        [[1.4, 6.0, -0.5, 3.5], [0.3, 0.6, -1.0, 2.0], [90.0, 140.0, 0.1, 1.5]],
    ),
    "beta by moments": (
        Beta(
            mean=Decision(3.0, 2.5, 4.0),
            std=Decision(0.7, 0.1, 1.0),
            lower=Decision(1.0, 0.5, 1.2),
            upper=Decision(6.0, 5.5, 7.0),
        ),
        beta_by_moments,
        [[3.2, 0.6, 0.8, 6.5]],
    ),
    "gamma by moments": (Gamma(**MOMENTS), gamma_by_moments, [[2.4, 0.8, 0.3], [1.2, 1.6, 0.1], [3.9, 0.2, 0.5]]),
}
SLOW = {
    "beta with small shapes": (
        Beta(alpha=Decision(0.4, 0.1, 1.0), beta=Decision(0.5, 0.1, 1.0)),
        stats.beta,
        [[0.3, 0.6]],
    ),
    "gamma by shape, large": (Gamma(shape=Decision(200.0, 50.0, 500.0), scale=1.0), stats.gamma, [[230.0]]),
    "gamma by shape, small": (Gamma(shape=Decision(0.6, 0.1, 1.0), scale=1.0), stats.gamma, [[0.4]]),
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


def values_and_slopes(function, x):
    """Values and Jacobian of one trace."""
    slopes, values = jax.jacfwd(lambda x: (function(x),) * 2, has_aux=True)(x)
    return values, slopes


def agree_with_scipy(oracle, x, values, slopes):
    assert np.asarray(values) == pytest.approx(oracle(*x).ppf(LEVELS), rel=1e-9), x
    expected = central_difference(lambda x: oracle(*x).ppf(LEVELS), x)
    # An entry may be far smaller than its row, where the differences are no better than that.
    allowed = 1e-6 * np.abs(expected) + 1e-8 * np.abs(expected).max(axis=1, keepdims=True) + 1e-12
    assert (np.abs(np.asarray(slopes) - expected) <= allowed).all(), (x, slopes, expected)


def test_numbers_and_slopes_by_decisions_are_those_of_scipys_quantile_at_the_level_of_the_germ():
    germs = {name: germs_of(distribution) for name, (distribution, *_) in QUICK.items()}
    program = compiled(
        lambda at: {
            name: values_and_slopes(lambda x, name=name: numbers_at(QUICK[name][0], germs[name], x), x)
            for name, x in at.items()
        }
    )
    starts = {name: placements(distribution).vector("initial") for name, (distribution, *_) in QUICK.items()}
    for at in (starts, {name: np.array(moved) for name, (*_, moved) in QUICK.items()}):
        found = program(at)
        for name, (_, oracle, _) in QUICK.items():
            agree_with_scipy(oracle, at[name], *found[name])


@pytest.mark.parametrize(
    ("distribution", "oracle", "places"),
    [*ITERATED.values(), *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW.values())],
    ids=[*ITERATED, *SLOW],
)
def test_numbers_and_slopes_of_betas_and_gammas_are_those_of_scipys_quantile(distribution, oracle, places):
    germs = germs_of(distribution)
    program = compiled(lambda x: values_and_slopes(lambda x: numbers_at(distribution, germs, x), x))
    for x in (placements(distribution).vector("initial"), *map(np.array, places)):
        agree_with_scipy(oracle, x, *program(x))


# a distribution of one shape parameter, its value, SciPy's distribution
SHAPES = {
    "beta": (lambda s: Beta(alpha=s, beta=5.0), 2.0, lambda s: stats.beta(s, 5.0)),
    "gamma": (lambda s: Gamma(shape=s, scale=0.5), 3.0, lambda s: stats.gamma(s, scale=0.5)),
    "weibull": (lambda s: Weibull(1.0, s), 2.2, lambda s: stats.weibull_min(s)),
    "triangular": (lambda s: Triangular(0.0, s, 1.0), 0.3, lambda s: stats.triang(s)),
    "lognormal": (lambda s: LogNormal(median=1.0, log_std=s), 0.3, lambda s: stats.lognorm(s)),
    "beta, second": (lambda s: Beta(alpha=2.5, beta=s), 3.0, lambda s: stats.beta(2.5, s)),
    "truncated normal": (
        lambda s: TruncatedNormal(1.0, s, lower=0.0, upper=2.5),
        0.8,
        lambda s: truncated_normal(1.0, s, 0.0, 2.5),
    ),
}


def first_and_second_difference(function, x, relative_step=2e-2):
    """Of sixth order."""
    h = relative_step * abs(x)
    values = np.array([function(x + k * h) for k in (-3, -2, -1, 0, 1, 2, 3)])
    first, second = np.array([-1, 9, -45, 0, 45, -9, 1]), np.array([2, -27, 270, -490, 270, -27, 2])
    return first @ values / (60 * h), second @ values / (180 * h**2)


@pytest.mark.parametrize(
    "names",
    [
        ("weibull", "triangular", "lognormal"),
        ("beta",),
        ("gamma",),
        *(pytest.param((name,), marks=pytest.mark.slow) for name in ("beta, second", "truncated normal")),
    ],
    ids=lambda names: names[0],
)
def test_first_and_second_derivatives_by_decided_and_by_traced_shapes_are_those_of_scipy(names):
    levels = np.array([0.02, 0.6, 0.995])

    def numbers(name, shape, germs):
        """The numbers by a decision and by a traced shape; and the latter added up, for derivatives in reverse."""
        make, start, _ = SHAPES[name]
        decided = make(Decision(start, 0.8 * start, 1.25 * start))
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


@pytest.mark.slow
def test_mixed_second_derivatives_of_a_beta_quantile_are_differences_of_the_first():
    distribution = Beta(alpha=Decision(2.0, 1.0, 4.0), beta=Decision(3.0, 1.0, 4.0), upper=Decision(2.0, 1.0, 3.0))
    xi, x = np.asarray(distribution.germ().quantile(np.array([0.7]))), np.array([2.2, 2.7, 1.9])
    gradient = jax.grad(lambda x: realise(distribution, jnp.asarray(xi), x))
    slopes = compiled(lambda x: (gradient(x), jax.jacfwd(gradient)(x)))
    seconds = np.asarray(slopes(x)[1])
    assert seconds == pytest.approx(central_difference(lambda x: np.asarray(slopes(x)[0]), x), rel=1e-7, abs=1e-8)
    assert seconds == pytest.approx(seconds.T, rel=1e-9)


def test_slopes_by_the_germ_are_those_of_scipys_quantile():
    cases = [(QUICK | ITERATED)[name] for name in ("normal", "weibull", "gamma by moments")]
    decided = [np.array(where[0] if np.ndim(where[0]) else where) for *_, where in cases]
    level = np.array([0.4])
    germs = [case[0].germ().quantile(level) for case in cases]
    exact = compiled(
        lambda germs: [
            jax.grad(lambda xi, d=case[0], x=x: realise(d, xi, x))(xi)
            for case, x, xi in zip(cases, decided, germs, strict=True)
        ]
    )([jnp.asarray(xi) for xi in germs])
    for (distribution, oracle, _), x, slope in zip(cases, decided, exact, strict=True):
        by_level = central_difference(lambda u, o=oracle, x=x: o(*x).ppf(u[0]), level)
        germ_by_level = central_difference(lambda u, d=distribution: d.germ().quantile(u)[0], level)
        assert np.asarray(slope) == pytest.approx(by_level / germ_by_level, rel=1e-6)


def test_an_expansion_built_anew_from_a_shape_under_differentiation_has_the_slope_of_its_moments():
    make, shape, _ = SHAPES["weibull"]
    value = jax.jit(lambda s, nodes, weights: weights @ jnp.sin(jax.vmap(make(s).value)(nodes)))

    def mean(s):
        nodes, weights = make(s).germ().gauss(30)
        return value(s, nodes, weights)

    def by_basis(s):
        nodes, weights = make(s).germ().gauss(30)
        return np.array([weights @ np.sin(nodes)])  # scale 1, location 0

    expected = central_difference(lambda s: by_basis(s[0]), [shape])[0, 0]
    assert float(jax.grad(mean)(shape)) == pytest.approx(expected, rel=1e-5)


MADE = [
    Weibull(mean=2.0, std=0.5),
    LogNormal(mean=2.0, std=0.5),
    TruncatedNormal(1.0, 0.5, lower=0.0),
    Triangular(0.0, 0.3, Decision(1.0, 0.5, 2.0)),
    Gamma(mean=Decision(2.0, 1.0, 3.0), std=0.5),
]


def test_distributions_of_known_numbers_may_be_made_and_expanded_inside_compiled_code():
    @compiled
    def means(starts):
        found = []
        for one, x in zip(MADE, starts, strict=True):
            made = type(one)(**one.parameters)
            nodes, weights = made.germ().gauss(20)
            found.append((jnp.asarray(weights) @ numbers_at(made, nodes[:, None], x), made.initial().mean()))
        return found

    for mean, expected in means([placements(one).vector("initial") for one in MADE]):
        assert float(mean) == pytest.approx(float(expected), rel=1e-12)


def test_moments_are_differentiable_in_every_parameter():
    cases = [
        (lambda p: LogNormal(mean=p[0], std=p[1]), np.array([2.0, 0.5]), None),
        (lambda p: Weibull(mean=p[0], std=p[1], lower=p[2]), np.array([2.0, 0.5, 0.3]), None),
        (lambda p: Gumbel(mean=p[0], std=p[1]), np.array([2.0, 0.5]), None),
        (
            lambda p: TruncatedNormal(p[0], p[1], lower=p[2]),
            np.array([1.0, 0.5, 0.3]),
            lambda p: truncated_normal(p[0], p[1], p[2]).stats("mv"),
        ),
    ]

    def moments(make):
        return lambda p: jnp.stack([make(p).mean(), make(p).std()])

    starts = [start for _, start, _ in cases]
    slopes = compiled(lambda ps: [jax.jacfwd(moments(c[0]))(p) for c, p in zip(cases, ps, strict=True)])(starts)
    for (_, start, oracle), found in zip(cases, slopes, strict=True):
        expected = np.eye(2, len(start))
        if oracle is not None:
            expected = central_difference(lambda p, o=oracle: np.array([o(p)[0], np.sqrt(o(p)[1])]), start)
        assert np.asarray(found) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_the_germ_and_the_collocation_matrix_do_not_depend_on_the_decisions_values():
    decided, fixed = Gamma(**MOMENTS), Gamma(mean=2.0, std=1.0, lower=0.5)
    assert decided.germ() == fixed.germ()
    first, second = (collocate({"x": one.germ()}, Expansion(4)).collocation for one in (decided, fixed))
    assert np.array_equal(first.matrix, second.matrix)


def test_a_germ_whose_shape_is_no_known_number_is_refused():
    for name, (make, shape, _) in SHAPES.items():
        if name == "lognormal":
            continue  # its germ is the same for every shape
        with pytest.raises(ProblemError, match=r"known numbers.*jax\.grad works"):
            jax.jit(lambda s, make=make: make(s).germ().gauss(3)[0].sum())(shape)


def test_parameters_that_make_no_distribution_are_refused_while_they_are_differentiated():
    with pytest.raises(ProblemError, match=r"Beta needs .*received Beta"):
        jax.grad(lambda a: Beta(alpha=a, beta=5.0).mean())(-1.0)
    with pytest.raises(ProblemError, match="Normal needs"):
        jax.grad(lambda s: Normal(0.0, s).std())(0.0)
