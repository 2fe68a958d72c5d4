"""Derivatives by shapes: those of a differentiated basis, of first and second order, decided or traced by JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    Beta,
    Decision,
    Gamma,
    Gumbel,
    LogNormal,
    Normal,
    Triangular,
    TruncatedNormal,
    Weibull,
    realise,
)
from compiling import compiled

NONE = jnp.zeros(0)

# a distribution of one shape parameter, its value, scipy's distribution
CASES = {
    "beta, first": (lambda s: Beta(alpha=s, beta=5.0), 2.0, lambda s: stats.beta(s, 5.0)),
    "beta, second": (lambda s: Beta(alpha=2.5, beta=s), 3.0, lambda s: stats.beta(2.5, s)),
    "gamma": (lambda s: Gamma(shape=s, scale=0.5), 3.0, lambda s: stats.gamma(s, scale=0.5)),
    "weibull": (lambda s: Weibull(1.0, s), 2.2, lambda s: stats.weibull_min(s)),
    "triangular": (lambda s: Triangular(0.0, s, 1.0), 0.3, lambda s: stats.triang(s)),
    "truncated normal": (
        lambda s: TruncatedNormal(1.0, s, lower=0.0, upper=2.5),
        0.8,
        lambda s: stats.truncnorm(-1 / s, 1.5 / s, 1.0, s),
    ),
    "lognormal": (lambda s: LogNormal(median=1.0, log_std=s), 0.3, lambda s: stats.lognorm(s)),
}


# they take long to compile, and each has a sibling above that does not
SLOW = ("beta, second", "truncated normal")
MARKED = [pytest.param(case, id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name, case in CASES.items()]


@pytest.fixture(params=MARKED)
def case(request):
    return request.param


def decided(make, shape):
    return make(Decision(shape, 0.8 * shape, 1.25 * shape))


def fine_rule(distribution, count=4000):
    """Germ values and weights of the midpoint rule in a variable that is flat at both ends of the levels."""
    t = (np.arange(count) + 0.5) / count
    levels, weights = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3), 140 * t**3 * (1 - t) ** 3 / count
    return jnp.asarray(distribution.germ().quantile(levels)), jnp.asarray(weights)


def smooth(x):
    return jnp.sin(x) + jnp.exp(-x)


def moments(distribution, points, weights, x=NONE):
    """Mean and variance of a smooth function of the number."""
    values = smooth(jax.vmap(lambda xi: realise(distribution, xi[None], x))(points))
    mean = weights @ values
    return jnp.stack([mean, weights @ (values - mean) ** 2])


def moments_of_new_basis(distribution):
    """Mean and variance from the coefficients of an expansion in the distribution's own polynomials."""
    germ = distribution.germ()
    nodes, weights = germ.gauss(40)
    values = np.asarray(smooth(jax.vmap(distribution.value)(jnp.asarray(nodes))))
    coefficients = (germ.polynomials(18, nodes).T * weights) @ values
    return np.array([coefficients[0], np.sum(coefficients[1:] ** 2)])


def central_difference(function, x, relative_step=1e-2):
    """Sixth order, so that a step far above the rounding of the moments is accurate enough."""
    h = relative_step * abs(x)
    differences = [function(x + k * h) - function(x - k * h) for k in (1, 2, 3)]
    return (45 * differences[0] - 9 * differences[1] + differences[2]) / (60 * h)


def test_derivatives_of_moments_by_a_decided_shape_are_those_of_the_differentiated_basis(case):
    make, shape, _ = case
    distribution = decided(make, shape)
    points, weights = fine_rule(distribution)
    ours = compiled(jax.jacfwd(lambda x: moments(distribution, points, weights, x)))(jnp.array([shape]))[:, 0]
    differentiated = central_difference(lambda s: moments_of_new_basis(make(s)), shape)
    assert ours == pytest.approx(differentiated, rel=1e-6)


def test_derivatives_by_a_traced_shape_are_those_by_a_decision(case):
    make, shape, _ = case
    distribution = decided(make, shape)
    points, weights = fine_rule(distribution, 50)
    exact = compiled(jax.jacfwd(lambda x: moments(distribution, points, weights, x)))(jnp.array([shape]))[:, 0]
    forward, reverse = (
        compiled(jacobian(lambda s: moments(make(s), points, weights)))(shape) for jacobian in (jax.jacfwd, jax.jacrev)
    )
    assert forward == pytest.approx(np.asarray(exact), rel=1e-10)
    assert reverse == pytest.approx(np.asarray(exact), rel=1e-10)


@pytest.mark.parametrize("name", ["beta, first", "weibull"])
def test_a_whole_expansion_may_be_built_from_a_shape_under_differentiation(name):
    make, shape, _ = CASES[name]

    def mean(s):
        nodes, weights = make(s).germ().gauss(30)
        return jnp.asarray(weights) @ smooth(jax.vmap(make(s).value)(jnp.asarray(nodes)))

    assert float(jax.grad(mean)(shape)) == pytest.approx(central_difference(lambda s: float(mean(s)), shape), rel=1e-5)


def second_difference(function, x, relative_step=2e-2):
    """Sixth order."""
    h = relative_step * abs(x)
    values = np.array([function(x + k * h) for k in (-3, -2, -1, 0, 1, 2, 3)])
    return np.array([2, -27, 270, -490, 270, -27, 2]) @ values / (180 * h**2)


LEVELS = np.array([0.02, 0.6, 0.995])


def test_second_derivatives_of_quantiles_by_a_decided_shape_are_those_of_scipy(case):
    make, shape, oracle = case
    distribution = decided(make, shape)
    germs = jnp.asarray(distribution.germ().quantile(LEVELS))
    hessian = jax.vmap(jax.hessian(lambda x, xi: realise(distribution, xi[None], x)), in_axes=(None, 0))
    exact = compiled(hessian)(jnp.array([shape]), germs)[:, 0, 0]
    assert exact == pytest.approx(second_difference(lambda s: oracle(s).ppf(LEVELS), shape), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("name", ["gamma", "weibull", "triangular"])
def test_second_derivatives_of_quantiles_by_a_traced_shape_are_those_of_scipy(name):
    make, shape, oracle = CASES[name]
    germs = jnp.asarray(make(shape).germ().quantile(LEVELS))
    hessian = jax.vmap(jax.hessian(lambda s, xi: make(s).value(xi)), in_axes=(None, 0))
    exact = compiled(hessian)(shape, germs)
    assert exact == pytest.approx(second_difference(lambda s: oracle(s).ppf(LEVELS), shape), rel=1e-5, abs=1e-7)


@pytest.mark.slow
def test_mixed_second_derivatives_of_a_beta_quantile_are_differences_of_the_first():
    distribution = Beta(alpha=Decision(2.0, 1.0, 4.0), beta=Decision(3.0, 1.0, 4.0), upper=Decision(2.0, 1.0, 3.0))
    xi = jnp.asarray(distribution.germ().quantile(np.array([0.7])))
    x = jnp.array([2.2, 2.7, 1.9])
    gradient = compiled(jax.grad(lambda x: realise(distribution, xi, x)))
    exact = compiled(jax.hessian(lambda x: realise(distribution, xi, x)))(x)
    for i in range(3):
        step = jnp.zeros(3).at[i].set(1e-3)
        near, far = (gradient(x + k * step) - gradient(x - k * step) for k in (1, 2))
        assert exact[i] == pytest.approx(np.asarray((8 * near - far) / 12e-3), rel=1e-7, abs=1e-8)
    assert exact == pytest.approx(np.asarray(exact).T, rel=1e-9)


def test_a_shape_traced_inside_compiled_code_is_still_differentiated():
    start = jnp.asarray(Beta(alpha=2.0, beta=5.0).germ().quantile(np.array(0.3)))
    value = jax.jit(lambda a: Beta(alpha=a, beta=5.0).value(start))
    exact = central_difference(lambda a: stats.beta(a, 5.0).ppf(0.3), 2.0)
    assert float(jax.grad(value)(2.0)) == pytest.approx(exact, rel=1e-9)
    assert float(value(2.0)) == pytest.approx(stats.beta(2, 5).ppf(0.3), rel=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Weibull(mean=2.0, std=0.5),
        lambda: LogNormal(mean=2.0, std=0.5),
        lambda: TruncatedNormal(1.0, 0.5, lower=0.0),
        lambda: Triangular(0.0, 0.3, Decision(1.0, 0.5, 2.0)),
        lambda: Gamma(mean=Decision(2.0, 1.0, 3.0), std=0.5),
    ],
)
def test_a_distribution_of_known_numbers_may_be_made_and_expanded_inside_compiled_code(make):
    @compiled
    def mean(x):
        distribution = make()
        nodes, weights = distribution.germ().gauss(20)
        return jnp.asarray(weights) @ jax.vmap(lambda xi: realise(distribution, xi[None], x))(jnp.asarray(nodes))

    start = jnp.array([float(decision.initial) for decision in make().decisions.values()])
    assert float(mean(start)) == pytest.approx(float(make().initial().mean()), rel=1e-12)


@pytest.mark.parametrize(
    "transform", [jax.jit, lambda f: lambda x: jax.vmap(f)(jnp.array([x, x]))], ids=["jit", "vmap"]
)
def test_a_germ_whose_shape_is_no_known_number_is_refused(case, transform):
    make, shape, _ = case
    if isinstance(make(shape), LogNormal):
        return  # its germ is the same for every shape
    with pytest.raises(ProblemError, match=r"known numbers.*jax\.grad works"):
        transform(lambda s: make(s).germ().gauss(3)[0].sum())(shape)


def test_parameters_that_make_no_distribution_are_refused_while_they_are_differentiated():
    with pytest.raises(ProblemError, match=r"Beta needs .*received Beta"):
        jax.grad(lambda a: Beta(alpha=a, beta=5.0).mean())(-1.0)
    with pytest.raises(ProblemError, match="Normal needs"):
        jax.grad(lambda s: Normal(0.0, s).std())(0.0)


def test_moments_are_differentiable_in_every_parameter():
    distributions = [
        (lambda p: LogNormal(mean=p[0], std=p[1]), [2.0, 0.5]),
        (lambda p: Weibull(mean=p[0], std=p[1], lower=p[2]), [2.0, 0.5, 0.3]),
        (lambda p: Gumbel(mean=p[0], std=p[1]), [2.0, 0.5]),
    ]
    for make, start in distributions:
        both = compiled(jax.jacfwd(lambda p, make=make: jnp.stack([make(p).mean(), make(p).std()])))
        assert both(jnp.array(start)) == pytest.approx(np.eye(2, len(start)), abs=1e-9)


def test_moments_of_a_truncated_normal_are_differentiable_on_its_open_side():
    start, h = np.array([1.0, 0.5, 0.3]), 1e-4

    def both(p):
        distribution = TruncatedNormal(p[0], p[1], lower=p[2])
        return jnp.stack([distribution.mean(), distribution.std()])

    def scipys(p):
        location, scale, lower = p
        distribution = stats.truncnorm((lower - location) / scale, np.inf, location, scale)
        return np.array([distribution.mean(), distribution.std()])

    steps = h * np.eye(3)
    differences = np.stack([(scipys(start + step) - scipys(start - step)) / (2 * h) for step in steps], axis=1)
    assert compiled(jax.jacfwd(both))(jnp.asarray(start)) == pytest.approx(differences, rel=1e-6)
