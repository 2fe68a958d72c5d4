"""Moments, supports and refusals of the families, in every way to give their parameters."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from aleator._core.errors import ProblemError
from aleator.uncertainty import Beta, Decision, Gamma, Normal, Uniform


def beta_by_moments(mean, std, lower, upper):
    """Solve for the shapes with a textbook formula on the unit interval."""
    m, v = (mean - lower) / (upper - lower), (std / (upper - lower)) ** 2
    alpha = m**2 * (1 - m) / v - m
    return stats.beta(alpha, alpha * (1 - m) / m, lower, upper - lower)


DISTRIBUTIONS = {
    "uniform by half-width": (Uniform(376.0, half_width=47.0), stats.uniform(329, 94)),
    "uniform by std": (Uniform(2.0, std=0.5), stats.uniform(2 - 0.5 * 3**0.5, 3**0.5)),
    "uniform by bounds": (Uniform.bounds(-3, 5.5), stats.uniform(-3, 8.5)),
    "uniform with negative mean": (Uniform(mean=-2.0, half_width=1.0), stats.uniform(-3, 2)),
    "normal": (Normal(1.5, 0.2), stats.norm(1.5, 0.2)),
    "normal by keyword": (Normal(std=3, mean=-1), stats.norm(-1, 3)),
    "beta by shape": (Beta(alpha=2.0, beta=5.0), stats.beta(2, 5)),
    "beta by shape on an interval": (Beta(alpha=0.5, beta=3.0, lower=-2, upper=4), stats.beta(0.5, 3, -2, 6)),
    "beta by moments": (Beta(mean=0.3, std=0.1), beta_by_moments(0.3, 0.1, 0, 1)),
    "beta by moments on an interval": (
        Beta(mean=3.0, std=0.7, lower=1.0, upper=6.0),
        beta_by_moments(3.0, 0.7, 1.0, 6.0),
    ),
    "gamma by shape": (Gamma(shape=4.0, scale=0.5), stats.gamma(4, scale=0.5)),
    "gamma by shape above a bound": (Gamma(shape=0.7, scale=2.0, lower=-1.0), stats.gamma(0.7, -1, 2)),
    "gamma by moments": (Gamma(mean=2.0, std=1.0), stats.gamma(4, scale=0.5)),
    "gamma by moments above a bound": (Gamma(mean=5.0, std=1.0, lower=3.0), stats.gamma(4, 3, 0.5)),
}


@pytest.fixture(params=DISTRIBUTIONS.values(), ids=DISTRIBUTIONS.keys())
def distribution_and_oracle(request):
    return request.param


def test_the_mean_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    assert float(distribution.mean()) == pytest.approx(oracle.mean(), rel=1e-13)


def test_the_standard_deviation_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    assert float(distribution.std()) == pytest.approx(oracle.std(), rel=1e-13)


def test_the_support_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    assert tuple(map(float, distribution.support())) == pytest.approx(oracle.support(), rel=1e-13)


def test_values_are_the_quantiles_of_scipy_at_the_germs_quantiles(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    levels = np.linspace(0.01, 0.99, 9)
    values = [float(distribution.value(jnp.asarray(xi))) for xi in distribution.germ().quantile(levels)]
    assert values == pytest.approx(oracle.ppf(levels), rel=1e-12, abs=1e-12)


def test_moments_by_gauss_quadrature_of_the_realised_number_are_those_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    nodes, weights = distribution.germ().gauss(3)
    values = np.array([float(distribution.value(jnp.asarray(xi))) for xi in nodes])
    for k in range(5):
        assert weights @ values**k == pytest.approx(oracle.moment(k), rel=1e-10)


BAD_NUMBERS = [0.0, -1.0, float("nan"), float("inf"), -float("inf")]
SPREADS = {
    "Uniform half_width": lambda s: Uniform(1.0, half_width=s),
    "Uniform std": lambda s: Uniform(1.0, std=s),
    "Normal std": lambda s: Normal(1.0, s),
    "Beta std": lambda s: Beta(mean=0.3, std=s),
    "Beta alpha": lambda s: Beta(alpha=s, beta=2.0),
    "Beta beta": lambda s: Beta(alpha=2.0, beta=s),
    "Gamma scale": lambda s: Gamma(shape=2.0, scale=s),
    "Gamma shape": lambda s: Gamma(shape=s, scale=2.0),
    "Gamma std": lambda s: Gamma(mean=2.0, std=s),
}


@pytest.mark.parametrize("bad", BAD_NUMBERS)
@pytest.mark.parametrize("name", SPREADS)
def test_a_spread_or_shape_that_is_not_positive_and_finite_is_refused_by_name_and_value(name, bad):
    family, parameter = name.split()
    with pytest.raises(ProblemError) as refusal:
        SPREADS[name](bad)
    assert str(refusal.value).startswith(family)
    assert f"{parameter}={bad:g}" in str(refusal.value)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize(
    "make",
    [
        lambda m: Uniform(m, half_width=1.0),
        lambda m: Normal(m, 1.0),
        lambda m: Beta(mean=m, std=0.1),
        lambda m: Gamma(mean=m, std=0.1),
        lambda m: Beta(alpha=2.0, beta=2.0, upper=m),
        lambda m: Gamma(shape=2.0, scale=2.0, lower=m),
        lambda m: Uniform.bounds(0.0, m),
    ],
)
def test_a_location_that_is_not_finite_is_refused(make, bad):
    with pytest.raises(ProblemError, match=f"received .*{bad:g}"):
        make(bad)


@pytest.mark.parametrize(
    ("make", "received"),
    [
        (lambda: Uniform.bounds(2.0, 1.0), "Uniform needs lower < upper.*lower=2, upper=1"),
        (lambda: Uniform.bounds(1.0, 1.0), "Uniform needs lower < upper.*lower=1, upper=1"),
        (lambda: Beta(alpha=2.0, beta=2.0, lower=1.0, upper=1.0), "Beta needs lower < upper.*lower=1, upper=1"),
        (lambda: Beta(mean=1.0, std=0.1, lower=1.0, upper=1.0), "Beta needs lower < upper.*lower=1, upper=1"),
        (lambda: Beta(alpha=2.0, beta=2.0, lower=3.0, upper=1.0), "Beta needs lower < upper.*lower=3, upper=1"),
        # a standard deviation on [0, 1] is at most sqrt(mean (1 - mean)), here 0.458
        (lambda: Beta(mean=0.3, std=0.46), "Beta.*mean=0.3, std=0.46"),
        (lambda: Beta(mean=1.2, std=0.1), "Beta.*mean=1.2"),
        (lambda: Beta(mean=-0.2, std=0.1), "Beta.*mean=-0.2"),
        (lambda: Beta(mean=0.0, std=0.1), "Beta.*mean=0"),
        (lambda: Beta(mean=1.0, std=0.1), "Beta.*mean=1"),
        (lambda: Gamma(mean=0.0, std=1.0), "Gamma.*mean=0"),
        (lambda: Gamma(mean=-2.0, std=1.0), "Gamma.*mean=-2"),
        (lambda: Gamma(mean=2.0, std=1.0, lower=3.0), "Gamma.*mean=2.*lower=3"),
        (lambda: Gamma(mean=1e200, std=1e-3), "Gamma.*mean=1e.200"),
        (lambda: Normal(1.0, Decision(0.0, 0.0)), r"Normal.*std=Decision\(0 in \[0, inf\]\)"),
    ],
)
def test_parameters_that_make_no_distribution_are_refused_with_the_family_and_what_was_received(make, received):
    with pytest.raises(ProblemError, match=received):
        make()


NARROW, FINITE = "Narrow the bounds of its decisions", "Give the decision finite bounds"
INSIDE_OUT = {
    "gamma below its bound": (lambda: Gamma(mean=Decision(2, -3, 5), std=1), "mean=-3", NARROW),
    "gamma at its bound": (lambda: Gamma(mean=Decision(2, 0, 5), std=1), "mean=0", NARROW),
    "gamma above its mean": (lambda: Gamma(mean=2, std=1, lower=Decision(0, -1, 3)), "lower=3", NARROW),
    "gamma without spread": (lambda: Gamma(mean=2, std=Decision(1, 0, 2)), "std=0", NARROW),
    "gamma with hidden sign": (lambda: Gamma(mean=2, std=Decision(1, -1, 2)), "std=-1", NARROW),
    "gamma without shape": (lambda: Gamma(shape=Decision(1, 0, 2), scale=1), "shape=0", NARROW),
    "gamma of negative scale": (lambda: Gamma(shape=1, scale=Decision(1, -1, 2)), "scale=-1", NARROW),
    "gamma of unbounded shape": (lambda: Gamma(shape=Decision(1, 0.1), scale=1), "shape=inf", FINITE),
    "gamma of unbounded mean": (lambda: Gamma(mean=Decision(1, 0.1), std=1), "mean=inf", FINITE),
    "gamma of unbounded std": (lambda: Gamma(mean=1, std=Decision(1, 0.1)), "std=inf", FINITE),
    "uniform crossing": (lambda: Uniform.bounds(Decision(1, 0, 5), Decision(2, 0, 5)), "lower=5, upper=0", NARROW),
    "uniform crossing far away": (lambda: Uniform.bounds(Decision(1), 2), "lower=inf", FINITE),
    "uniform of negative half-width": (lambda: Uniform(0, half_width=Decision(1, -2, 5)), "half_width=-2", NARROW),
    "normal of negative std": (lambda: Normal(Decision(0, -1, 1), Decision(1, -2, 5)), "mean=-1, std=-2", NARROW),
    "normal of unbounded std": (lambda: Normal(1.0, Decision(0.1)), "std=-inf", FINITE),
    "beta crossing": (
        lambda: Beta(alpha=2, beta=2, lower=Decision(0, -1, 2), upper=Decision(1, 0, 3)),
        "lower=2, upper=0",
        NARROW,
    ),
    "beta of zero width by moments": (
        lambda: Beta(mean=0.5, std=0.1, lower=Decision(0, 0, 1), upper=1),
        "lower=1",
        NARROW,
    ),
    "beta beyond its upper end": (lambda: Beta(mean=Decision(0.5, 0.2, 1.5), std=0.1), "mean=1.5", NARROW),
    "beta wider than possible": (lambda: Beta(mean=Decision(0.5, 0.1, 0.9), std=0.4), "mean=0.1", NARROW),
    "beta of unbounded std": (lambda: Beta(mean=0.5, std=Decision(0.1, 0.01)), "std=inf", FINITE),
    "beta of unbounded mean": (lambda: Beta(mean=Decision(0.5, 0.1), std=0.1), "mean=inf", FINITE),
    "beta without shape": (lambda: Beta(alpha=Decision(1, 0, 2), beta=2), "alpha=0", NARROW),
}


@pytest.mark.parametrize(("make", "corner", "remedy"), INSIDE_OUT.values(), ids=INSIDE_OUT.keys())
def test_a_distribution_that_its_decisions_turn_inside_out_is_refused_with_the_corner_and_the_remedy(
    make, corner, remedy
):
    with pytest.raises(ProblemError, match=f"its decisions reach {corner}, where it is no distribution.*{remedy}"):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Normal(Decision(0), Decision(1, 0)),
        lambda: Uniform(Decision(0), half_width=Decision(1, 0)),
        lambda: Uniform(Decision(0), std=Decision(1, 0)),
        lambda: Uniform.bounds(Decision(1, -np.inf, 2), Decision(3, 2, np.inf)),
        lambda: Beta(alpha=2, beta=2, lower=Decision(0, 0, 1), upper=1),
        lambda: Gamma(shape=2, scale=Decision(1, 0), lower=Decision(0)),
        lambda: Gamma(mean=Decision(2, 1, 5), std=Decision(1, 0.1, 2)),
        lambda: Beta(mean=Decision(0.5, 0.2, 0.8), std=Decision(0.1, 0.01, 0.3)),
    ],
)
def test_a_spread_may_vanish_or_grow_without_bound_where_every_decision_in_between_makes_a_distribution(make):
    make()


def test_decisions_shared_under_one_name_reach_only_the_corners_that_they_share():
    k = Decision(2.0, 1.0, 5.0).shared("k")
    distribution = Beta(mean=k, std=0.1, lower=0.0, upper=Decision(9.0, 6.0, 10.0))
    assert len(list(distribution.corners())) == 4
    assert list(Gamma(mean=k, std=k).corners()) == [{"mean": 1.0, "std": 1.0}, {"mean": 5.0, "std": 5.0}]


def test_a_decided_distribution_is_a_distribution_everywhere_between_its_bounds():
    distribution = Beta(
        mean=Decision(3.0, 2.5, 4.0),
        std=Decision(0.7, 0.1, 1.0),
        lower=Decision(1.0, 0.5, 1.2),
        upper=Decision(6.0, 5.5, 7.0),
    )
    generator = np.random.default_rng(1)
    for _ in range(200):
        somewhere = distribution.decided(lambda name, decision: generator.uniform(decision.lower, decision.upper))
        Beta(**somewhere.parameters)


def test_two_numbers_without_names_are_no_uniform_distribution():
    with pytest.raises(ProblemError, match=r"expected Uniform\(mean, half_width=...\), Uniform\(mean, std=...\).*4\.0"):
        Uniform(3.0, 4.0)


def test_the_largest_possible_standard_deviation_of_a_beta_distribution_is_nearly_reached():
    distribution = Beta(mean=0.3, std=0.45)
    assert float(distribution.std()) == pytest.approx(0.45, rel=1e-12)


@pytest.mark.parametrize(
    ("make", "received"),
    [
        (lambda: Uniform(1.0), r"Uniform takes \(mean, half_width\) or \(mean, std\) or \(lower, upper\).*\(mean\)"),
        (lambda: Uniform(), r"Uniform takes .*received \(\)"),
        (lambda: Uniform(1.0, half_width=0.1, std=0.1), r"received \(mean, half_width, std\)"),
        (lambda: Uniform(1.0, lower=0.0, upper=2.0), r"received \(mean, lower, upper\)"),
        (lambda: Uniform.bounds(1.0, None), r"received \(lower\)"),
        (lambda: Normal(1.0), r"Normal takes \(mean, std\); received \(mean\)"),
        (lambda: Beta(alpha=2.0), r"Beta takes .*received \(alpha, lower, upper\)"),
        (lambda: Beta(alpha=2.0, beta=3.0, mean=0.4, std=0.1), "Beta takes "),
        (lambda: Gamma(shape=2.0, std=1.0), r"Gamma takes .*received \(shape, std, lower\)"),
    ],
)
def test_missing_and_superfluous_parameters_are_refused_with_the_possible_ways(make, received):
    with pytest.raises(ProblemError, match=received):
        make()


@pytest.mark.parametrize(
    "bad",
    [
        np.array([1.0, 2.0]),
        [1.0],
        jnp.ones(2),
        "0.5",
        np.array("0.5"),
        Decision(np.array([1.0, 2.0])),
        1 + 2j,
        np.complex128(1),
        True,
        Normal(0.0, 1.0),
    ],
    ids=repr,
)
def test_a_parameter_that_is_not_one_real_number_is_refused_by_name(bad):
    with pytest.raises(ProblemError, match="Normal: 'std' takes one number or one Decision; received"):
        Normal(1.0, bad)


@pytest.mark.parametrize("number", [2, 2.0, np.float32(2), np.int64(2), np.array(2.0), jnp.asarray(2.0)], ids=repr)
def test_any_kind_of_one_real_number_is_a_parameter(number):
    assert float(Normal(0.0, number).std()) == 2.0


def test_misspelt_parameters_are_refused():
    with pytest.raises(TypeError, match="halfwidth"):
        Uniform(1.0, halfwidth=0.1)
