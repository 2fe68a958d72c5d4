"""The families outside the Askey scheme: moments, supports, quantiles and refusals against scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    Beta,
    Decision,
    Density,
    Exponential,
    Gamma,
    Gumbel,
    LogNormal,
    Normal,
    Sample,
    Triangular,
    TruncatedNormal,
    Uniform,
    Weibull,
    parameter,
    placements,
    refuse_nonpositive,
)

LEVELS = np.array([1e-4, 0.01, 0.2, 0.5, 0.83, 0.99, 0.9999])


def truncated(location, scale, lower=-np.inf, upper=np.inf):
    return stats.truncnorm((lower - location) / scale, (upper - location) / scale, location, scale)


def lognormal_by_moments(mean, std):
    variance = np.log(1 + (std / mean) ** 2)
    return stats.lognorm(variance**0.5, scale=mean / np.exp(variance / 2))


def bell(x):
    return 7.0 * np.exp(-(x**2) / 2)


# distribution, scipy's distribution
LINEAR = {
    "exponential by mean": (Exponential(mean=2.5), stats.expon(scale=2.5)),
    "exponential by mean above a bound": (Exponential(mean=2.5, lower=-1.0), stats.expon(-1, 3.5)),
    "exponential by rate": (Exponential(rate=4.0, lower=3.0), stats.expon(3, 0.25)),
    "weibull": (Weibull(2.0, 1.5), stats.weibull_min(1.5, scale=2.0)),
    "weibull with a small shape": (Weibull(scale=2.0, shape=0.6, lower=-3.0), stats.weibull_min(0.6, -3, 2.0)),
    "weibull with a large shape": (Weibull(scale=400.0, shape=40.0), stats.weibull_min(40.0, scale=400.0)),
    "gumbel": (Gumbel(1.0, 0.2), stats.gumbel_r(1.0, 0.2)),
    "triangular": (Triangular(1.0, 2.0, 4.0), stats.triang(1 / 3, 1, 3)),
    "triangular with its mode below": (Triangular(1.0, 1.0, 4.0), stats.triang(0, 1, 3)),
    "triangular with its mode above": (Triangular(-1.0, 4.0, 4.0), stats.triang(1, -1, 5)),
    "triangular and symmetric": (Triangular(mean=5.0, half_width=0.5), stats.triang(0.5, 4.5, 1.0)),
    "truncated normal": (TruncatedNormal(2.0, 0.5, lower=1.2, upper=3.5), truncated(2.0, 0.5, 1.2, 3.5)),
    "truncated normal below": (TruncatedNormal(1.0, 0.5, lower=0.0), truncated(1.0, 0.5, 0.0)),
    "truncated normal above": (TruncatedNormal(1.0, 0.5, upper=0.7), truncated(1.0, 0.5, upper=0.7)),
    "truncated normal in the tail": (TruncatedNormal(0.0, 1.0, lower=6.0, upper=8.0), truncated(0.0, 1.0, 6.0, 8.0)),
    "truncated normal in the other tail": (TruncatedNormal(0.0, 2.0, upper=-18.0), truncated(0.0, 2.0, upper=-18.0)),
    "a normal density": (Density(bell, -np.inf, np.inf, location=27.6, scale=0.05), stats.norm(27.6, 0.05)),
    "a density on the half line": (Density(lambda x: x * np.exp(-x), 0.0, np.inf), stats.gamma(2.0)),
    "a density without bound at its end": (Density(lambda x: x**-0.5, 0, 1, location=3.0), stats.beta(0.5, 1, 3)),
}
CURVED = {
    "lognormal by moments": (LogNormal(mean=3.0, std=0.8), lognormal_by_moments(3.0, 0.8)),
    "lognormal by median": (LogNormal(median=2.0, log_std=0.3), stats.lognorm(0.3, scale=2.0)),
    "lognormal above a bound": (LogNormal(log_mean=0.5, log_std=0.7, lower=-1), stats.lognorm(0.7, -1, np.exp(0.5))),
    "lognormal by median above a bound": (LogNormal(median=2.0, log_std=0.7, lower=-1), stats.lognorm(0.7, -1, 3)),
}
DISTRIBUTIONS = LINEAR | CURVED


@pytest.fixture(params=DISTRIBUTIONS.values(), ids=DISTRIBUTIONS.keys())
def distribution_and_oracle(request):
    return request.param


def test_the_mean_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    assert float(distribution.mean()) == pytest.approx(oracle.mean(), rel=1e-11)


def test_the_standard_deviation_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    # scipy's variance loses digits in the tail: there is a test by quadrature below
    in_tail = "upper=-18" in str(distribution) or "lower=6" in str(distribution)
    assert float(distribution.std()) == pytest.approx(oracle.std(), rel=1e-6 if in_tail else 1e-10)


def test_the_support_is_that_of_scipy(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    assert tuple(map(float, distribution.support())) == pytest.approx(oracle.support(), rel=1e-13)


def test_values_are_the_quantiles_of_scipy_at_the_germs_quantiles(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    values = [float(distribution.value(jnp.asarray(xi))) for xi in distribution.germ().quantile(LEVELS)]
    assert values == pytest.approx(oracle.ppf(LEVELS), rel=1e-11)


def test_values_at_a_normal_value_are_the_quantiles_of_scipy_at_its_probability(distribution_and_oracle):
    distribution, oracle = distribution_and_oracle
    normals = jnp.asarray([-4.0, -1.3, 0.0, 0.2, 2.0, 5.0])
    expected = np.where(normals < 0, oracle.ppf(stats.norm.cdf(normals)), oracle.isf(stats.norm.sf(normals)))
    values = jax.vmap(distribution.value_at_normal)(normals)
    assert values == pytest.approx(expected, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(("distribution", "oracle"), LINEAR.values(), ids=LINEAR.keys())
def test_moments_by_gauss_quadrature_of_the_realised_number_are_those_of_scipy(distribution, oracle):
    nodes, weights = distribution.germ().gauss(3)
    values = np.array([float(distribution.value(jnp.asarray(xi))) for xi in nodes])
    for k in range(1, 5):
        assert weights @ values**k == pytest.approx(oracle.moment(k), rel=1e-9)


def test_moments_of_a_lognormal_number_converge_with_the_order_of_the_gauss_rule():
    distribution = LogNormal(mean=3.0, std=0.8)
    nodes, weights = distribution.germ().gauss(30)
    values = np.asarray(jax.vmap(distribution.value)(jnp.asarray(nodes)))
    assert weights @ values == pytest.approx(3.0, rel=1e-13)
    assert np.sqrt(weights @ (values - 3.0) ** 2) == pytest.approx(0.8, rel=1e-12)
    assert (float(distribution.mean()), float(distribution.std())) == pytest.approx((3.0, 0.8), rel=1e-14)


@pytest.mark.parametrize("mean", [0.5, 3.0])
@pytest.mark.parametrize("std", [0.01, 0.3, 2.0])
def test_weibull_and_gumbel_distributions_by_moments_have_these_moments(mean, std):
    for distribution in (
        Weibull(mean=mean, std=std),
        Weibull(mean=mean - 4.0, std=std, lower=-4.0),
        Gumbel(mean=mean, std=std),
    ):
        _, scale, shape = (np.asarray(number) for number in distribution.canonical())
        oracle = stats.weibull_min(shape[0], distribution.canonical().location, scale) if shape.size else None
        oracle = oracle or stats.gumbel_r(distribution.canonical().location, scale)
        assert float(distribution.mean()) == pytest.approx(oracle.mean(), rel=1e-9)
        assert (oracle.mean(), oracle.std()) == pytest.approx((distribution.parameters["mean"], std), rel=1e-8)


@pytest.mark.parametrize("interval", [(6.0, 8.0), (-np.inf, -9.0), (3.0, 3.0 + 1e-5), (30.0, np.inf), (-1.0, 2.0)])
def test_moments_of_a_truncated_normal_keep_their_digits_in_tails_and_narrow_intervals(interval):
    low, high = interval
    distribution = TruncatedNormal(0.0, 1.0, lower=low, upper=high)
    nodes, weights = distribution.germ().gauss(20)
    mean = weights @ nodes
    assert float(distribution.mean()) == pytest.approx(mean, rel=1e-12)
    assert float(distribution.std()) == pytest.approx(np.sqrt(weights @ (nodes - mean) ** 2), rel=1e-9)
    assert low < mean < high


def test_the_standard_deviation_of_a_truncated_normal_in_a_tail_is_that_of_its_asymptotic_series():
    # Mills: beyond a, mean - a = 1/a - 2/a^3 + 10/a^5 - 74/a^7 + ..., variance = 1/a^2 - 6/a^4 + 50/a^6 - 518/a^8 + ...
    a = 30.0
    distribution = TruncatedNormal(0.0, 1.0, lower=a)
    assert float(distribution.mean()) - a == pytest.approx(1 / a - 2 / a**3 + 10 / a**5 - 74 / a**7, rel=1e-8)
    assert float(distribution.std()) ** 2 == pytest.approx(1 / a**2 - 6 / a**4 + 50 / a**6 - 518 / a**8, rel=1e-6)


def test_a_sample_has_the_moments_and_the_range_of_its_data():
    data = np.random.default_rng(3).gamma(2.0, size=57)
    distribution = Sample(data, location=1.0, scale=2.0)
    assert float(distribution.mean()) == pytest.approx(1 + 2 * data.mean(), rel=1e-14)
    assert float(distribution.std()) == pytest.approx(2 * data.std(), rel=1e-14)
    assert tuple(map(float, distribution.support())) == pytest.approx(
        (1 + 2 * data.min(), 1 + 2 * data.max()), rel=1e-15
    )


def test_quantiles_of_a_sample_are_those_of_the_empirical_distribution():
    data = np.random.default_rng(4).normal(size=40).round(1)  # some of them alike
    germ = Sample(data).germ()
    levels = np.linspace(0.001, 0.999, 77)
    assert np.array_equal(germ.quantile(levels), np.quantile(data, levels, method="inverted_cdf"))
    between = np.linspace(-4.03, 4.03, 30)
    assert germ.cumulative(between) == pytest.approx(stats.ecdf(data).cdf.evaluate(between), abs=1e-15)
    at = np.unique(data)
    middle = [np.mean(data < one) + np.mean(data == one) / 2 for one in at]
    assert germ.cumulative(at) == pytest.approx(middle, abs=1e-15)
    assert np.array_equal(germ.quantile(germ.cumulative(at)), at)


@pytest.mark.parametrize("data", [[1.02, 0.97, 1.05, 0.99, 1.01], [0.0, 1.0], [1.0, 1.0, 1.0, 5.0]])
def test_what_is_drawn_from_a_sample_has_its_moments_and_is_of_the_data(data):
    distribution = Sample(data, location=1.0, scale=2.0)
    count = 1000 * len(data)
    levels = (np.arange(count) + 0.5) / count  # each of the data at the same number of levels
    drawn = 1 + 2 * distribution.germ().quantile(levels)
    assert set(drawn) == set(1 + 2 * np.array(data))
    assert drawn.mean() == pytest.approx(float(distribution.mean()), rel=1e-12)
    assert drawn.std() == pytest.approx(float(distribution.std()), rel=1e-12)
    by_normal = [float(distribution.from_normal(normal, ())) for normal in stats.norm.ppf(levels[:: len(levels) // 50])]
    assert np.array_equal(by_normal, distribution.germ().quantile(levels[:: len(levels) // 50]))


def test_repeated_data_count_as_often_as_they_occur():
    germ = Sample([1.0, 1.0, 1.0, 5.0]).germ()
    nodes, weights = germ.gauss(2)
    assert nodes == pytest.approx([1.0, 5.0], rel=1e-13)
    assert weights == pytest.approx([0.75, 0.25], rel=1e-13)


def test_equal_data_make_equal_germs_whatever_their_order():
    assert Sample([3.0, 1.0, 2.0]).germ() == Sample(np.array([1, 2, 3])).germ()
    assert hash(Sample([3.0, 1.0, 2.0]).germ()) == hash(Sample([1.0, 2.0, 3.0]).germ())
    assert Sample([3.0, 1.0, 2.0]).germ() != Sample([3.0, 1.0, 2.5]).germ()


POSITIVE_NUMBERS = {
    "Exponential mean": lambda s: Exponential(mean=s),
    "Exponential rate": lambda s: Exponential(rate=s),
    "LogNormal mean": lambda s: LogNormal(mean=s, std=1.0),
    "LogNormal std": lambda s: LogNormal(mean=1.0, std=s),
    "LogNormal median": lambda s: LogNormal(median=s, log_std=1.0),
    "LogNormal log_std": lambda s: LogNormal(log_mean=1.0, log_std=s),
    "Weibull scale": lambda s: Weibull(s, 1.0),
    "Weibull shape": lambda s: Weibull(1.0, s),
    "Weibull mean": lambda s: Weibull(mean=s, std=1.0),
    "Weibull std": lambda s: Weibull(mean=1.0, std=s),
    "Gumbel scale": lambda s: Gumbel(0.0, s),
    "Gumbel std": lambda s: Gumbel(mean=0.0, std=s),
    "Triangular half_width": lambda s: Triangular(mean=0.0, half_width=s),
    "TruncatedNormal scale": lambda s: TruncatedNormal(1.0, s, lower=0.0),
    "Density scale": lambda s: Density(bell, -1.0, 1.0, scale=s),
    "Sample scale": lambda s: Sample([1.0, 2.0], scale=s),
}


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", POSITIVE_NUMBERS)
def test_a_number_that_must_be_positive_and_finite_is_refused_by_name_and_value(name, bad):
    family, parameter_name = name.split()
    with pytest.raises(ProblemError) as refusal:
        POSITIVE_NUMBERS[name](bad)
    assert str(refusal.value).startswith(f"{family} needs ")
    assert f"{parameter_name}={bad:g}" in str(refusal.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Exponential(mean=1.0, lower=2.0), "Exponential needs a finite mean above lower.*lower=2"),
        (lambda: Exponential(), r"Exponential takes \(mean, lower\) or \(rate, lower\)"),
        (lambda: LogNormal(mean=1.0, std=0.5, lower=1.0), "LogNormal needs .*lower=1"),
        (lambda: LogNormal(median=1.0, std=0.5), "LogNormal takes"),
        (lambda: Weibull(mean=1.0, std=0.5, lower=3.0), "Weibull needs .*lower=3"),
        (lambda: Triangular(1.0, 0.5, 2.0), "Triangular needs .*mode=0.5"),
        (lambda: Triangular(1.0, 2.5, 2.0), "Triangular needs .*mode=2.5"),
        (lambda: Triangular(2.0, 2.0, 2.0), "Triangular needs lower < upper"),
        (lambda: Triangular(1.0, float("nan"), 2.0), "Triangular needs .*mode=nan"),
        (lambda: TruncatedNormal(0.0, 1.0, lower=2.0, upper=1.0), "TruncatedNormal needs lower < upper"),
        (lambda: TruncatedNormal(0.0, 1.0, lower=40.0), "part of the interval within 37 scales.*lower=40"),
        (lambda: TruncatedNormal(0.0, 1.0, upper=-40.0), "part of the interval within 37 scales.*upper=-40"),
        (lambda: TruncatedNormal(float("inf"), 1.0, upper=0.0), "TruncatedNormal needs .*location=inf"),
        (lambda: Density(3.0, 0.0, 1.0), "Density takes a function"),
        (lambda: Density(bell, 1.0, 0.0), "Density needs lower < upper"),
        (lambda: Density(bell, float("nan"), 0.0), "Density needs lower < upper"),
        (lambda: Density(bell, Decision(0.0), 1.0), r"Density: lower: expected a plain number .*decisions"),
        (lambda: Sample([1.0]), "at least two differ"),
        (lambda: Sample([2.0, 2.0]), "at least two differ"),
        (lambda: Sample([1.0, np.nan]), "1 non-finite numbers"),
        (lambda: Sample([[1.0, 2.0]]), r"shape \(1, 2\)"),
        (lambda: Sample(["a", "b"]), "list or vector of numbers"),
        (lambda: Sample([1.0, 2.0, 4.0]).germ().recurrence(3), "up to order 2; received order 3"),
        (lambda: Triangular(1.0, Decision(2.0, 0.0, 3.0), 4.0), "its decisions reach mode=0, .*Narrow the bounds"),
        (lambda: Weibull(1.0, Decision(2.0, 0.0, 3.0)), "its decisions reach shape=0, .*Narrow the bounds"),
        (lambda: Weibull(mean=2.0, std=Decision(1.0, 0.0, 3.0)), "its decisions reach std=0, .*Narrow the bounds"),
        (lambda: LogNormal(mean=2.0, std=Decision(1.0, -1.0, 2.0)), "its decisions reach std=-1"),
        (lambda: TruncatedNormal(Decision(0.0), 1.0, lower=0.0), "location=-inf.*Give the decision finite bounds"),
        (lambda: Exponential(rate=Decision(1.0, 0.0, 2.0)), "its decisions reach rate=0"),
    ],
)
def test_parameters_that_make_no_distribution_are_refused_with_what_is_needed(make, message):
    with pytest.raises(ProblemError, match=message):
        make()


@pytest.mark.parametrize(
    ("density", "lower", "upper", "message"),
    [
        (lambda x: np.sin(x), 0.0, 7.0, "not negative.*received -0.*Correct the function"),
        (lambda x: np.where(x > 0.5, np.nan, 1.0), 0.0, 1.0, "finite and not negative.*received nan"),
        (lambda x: 0 * x, 0.0, 1.0, "no mass.*Set `lower` and `upper` closely"),
        (lambda x: np.exp(-(((x - 20) / 1e-3) ** 2)), -np.inf, np.inf, "no mass.*Set `lower` and `upper` closely"),
        (lambda x: 1 / x, 0.0, 1.0, "does not converge towards its end 0"),
        (lambda x: 1 / x, 1.0, np.inf, "does not converge towards its end inf"),
        (lambda x: (1 - x) ** -0.5, 0.0, 1.0, "grows without bound towards its end 1.*give `location`"),
        (lambda x: 1 / (1 + x**2), -np.inf, np.inf, "moments that they need do not exist"),
        (lambda x: 1.0, 0.0, 1.0, "one number for each.*NumPy"),
        (lambda x: 1 / (x - 0.3) ** 2, 0.0, 1.0, "could not be integrated|finite"),
    ],
)
def test_a_function_that_is_no_density_is_refused_with_the_remedy(density, lower, upper, message):
    with pytest.raises(ProblemError, match=message):
        Density(density, lower, upper)


def positive(distribution):
    import equinox as eqx

    class Mass(eqx.Module):
        m: object = parameter("kg", positive=True)

    return Mass(distribution)


@pytest.mark.parametrize(
    "distribution",
    [
        LogNormal(mean=1.0, std=0.5),
        LogNormal(mean=Decision(1.0, 0.5, 2.0), std=0.5),
        TruncatedNormal(1.0, 0.5, lower=0.1),
        Triangular(0.1, 0.2, 0.4),
        Weibull(1.0, 2.0, lower=0.3),
        Exponential(mean=Decision(2.0, 1.0, 3.0), lower=0.5),
        Sample([1.0, 2.0]),
        Density(lambda x: np.ones_like(x), 1.0, 2.0),
    ],
    ids=str,
)
def test_a_distribution_above_zero_may_stand_for_a_positive_number(distribution):
    refuse_nonpositive(positive(distribution))


@pytest.mark.parametrize(
    "distribution",
    [
        LogNormal(mean=1.0, std=0.5, lower=-0.1),
        TruncatedNormal(1.0, 0.5, upper=3.0),
        TruncatedNormal(1.0, 0.5, lower=Decision(0.1, 0.0, 0.2)),
        Triangular(0.0, 0.2, 0.4),
        Weibull(1.0, 2.0),
        Gumbel(10.0, 0.1),
        Exponential(mean=2.0),
        Sample([1.0, 2.0], location=Decision(0.0, -2.0, 0.0)),
        Density(lambda x: np.ones_like(x), 0.0, 2.0),
    ],
    ids=str,
)
def test_a_distribution_that_reaches_zero_may_not_stand_for_a_positive_number(distribution):
    with pytest.raises(ProblemError, match="must stay positive"):
        refuse_nonpositive(positive(distribution))


@pytest.mark.parametrize(
    "distribution",
    [
        Uniform(1.0, half_width=0.2),
        Normal(1.0, 0.2),
        Beta(alpha=0.5, beta=3.0),
        Gamma(shape=0.4, scale=1.0),
        *(distribution for distribution, _ in DISTRIBUTIONS.values()),
    ],
    ids=str,
)
def test_a_germs_cumulative_is_the_inverse_of_its_quantile_and_ends_with_its_support(distribution):
    germ = distribution.germ()
    levels = np.array([[1e-6, 1e-3, 0.1], [0.5, 0.9, 1 - 1e-6]])
    assert germ.cumulative(germ.quantile(levels)) == pytest.approx(levels, rel=1e-9, abs=1e-10)
    low, high = germ.support()
    assert germ.cumulative(np.array([low - 1.0, low, high, high + 1.0])).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert low < germ.quantile(np.array(1e-6)) < germ.quantile(np.array(1 - 1e-6)) < high


def test_distributions_with_functions_and_data_can_be_shared_and_survive_flattening():
    for distribution in (Sample([1.0, 2.0, 3.0], location=Decision(0.0, -1.0, 1.0)), Density(bell, -1.0, 1.0)):
        shared = distribution.shared("x")
        leaves, structure = jax.tree.flatten(shared)
        again = jax.tree.unflatten(structure, leaves)
        assert again.germ() == distribution.germ()
        assert tuple(placements({"a": shared, "b": again}).distributions) == ("x",)


def test_a_distribution_says_what_it_is():
    assert str(Sample([1.0, 2.0, 2.0])) == "Sample(2 distinct values, location=0, scale=1)"
    assert str(Density(bell, -1, np.inf)) == "Density(bell on [-1, inf], location=0, scale=1)"
    assert str(LogNormal(mean=2, std=1)) == "LogNormal(mean=2, std=1, lower=0)"
