"""All families in every way to give their parameters: moments, supports, quantiles against SciPy; data; refusals."""

import jax
import numpy as np
import pytest
from scipy import stats

import aleator as al
from compiling import compiled

LEVELS = np.array([1e-4, 0.01, 0.2, 0.5, 0.83, 0.99, 0.9999])
NORMALS = np.array([-4.0, -1.3, 0.0, 0.2, 2.0, 5.0])


def truncated(location, scale, lower=-np.inf, upper=np.inf):
    return stats.truncnorm((lower - location) / scale, (upper - location) / scale, location, scale)


def lognormal_by_moments(mean, std):
    variance = np.log(1 + (std / mean) ** 2)
    return stats.lognorm(variance**0.5, scale=mean / np.exp(variance / 2))


def bell(x):
    return 7.0 * np.exp(-(x**2) / 2)


def beta_by_moments(mean, std, lower, upper):
    """Solve for the shapes with a textbook formula on the unit interval."""
    m, v = (mean - lower) / (upper - lower), (std / (upper - lower)) ** 2
    alpha = m**2 * (1 - m) / v - m
    return stats.beta(alpha, alpha * (1 - m) / m, lower, upper - lower)


# distribution, SciPy's distribution
LINEAR = {
    "uniform by std": (al.Uniform(2.0, std=0.5), stats.uniform(2 - 0.5 * 3**0.5, 3**0.5)),
    "uniform by bounds": (al.Uniform.bounds(-3, 5.5), stats.uniform(-3, 8.5)),
    "normal": (al.Normal(1.5, 0.2), stats.norm(1.5, 0.2)),
    "beta by shape on an interval": (al.Beta(alpha=0.5, beta=3.0, lower=-2, upper=4), stats.beta(0.5, 3, -2, 6)),
    "beta by moments on an interval": (
        al.Beta(mean=3.0, std=0.7, lower=1.0, upper=6.0),
        beta_by_moments(3.0, 0.7, 1.0, 6.0),
    ),
    "gamma by shape above a bound": (al.Gamma(shape=0.7, scale=2.0, lower=-1.0), stats.gamma(0.7, -1, 2)),
    "gamma by moments above a bound": (al.Gamma(mean=5.0, std=1.0, lower=3.0), stats.gamma(4, 3, 0.5)),
    "exponential by mean above a bound": (al.Exponential(mean=2.5, lower=-1.0), stats.expon(-1, 3.5)),
    "exponential by rate": (al.Exponential(rate=4.0, lower=3.0), stats.expon(3, 0.25)),
    "weibull with a small shape": (al.Weibull(scale=2.0, shape=0.6, lower=-3.0), stats.weibull_min(0.6, -3, 2.0)),
    "gumbel": (al.Gumbel(1.0, 0.2), stats.gumbel_r(1.0, 0.2)),
    "triangular with its mode below": (al.Triangular(1.0, 1.0, 4.0), stats.triang(0, 1, 3)),
    "triangular and symmetric": (al.Triangular(mean=5.0, half_width=0.5), stats.triang(0.5, 4.5, 1.0)),
    "truncated normal": (al.TruncatedNormal(2.0, 0.5, lower=1.2, upper=3.5), truncated(2.0, 0.5, 1.2, 3.5)),
    "truncated normal above": (al.TruncatedNormal(1.0, 0.5, upper=0.7), truncated(1.0, 0.5, upper=0.7)),
    "truncated normal far away": (al.TruncatedNormal(1.0, 1e-5, lower=0.0), truncated(1.0, 1e-5, 0.0)),
    "truncated normal in the tail": (al.TruncatedNormal(0.0, 1.0, lower=6.0, upper=8.0), truncated(0.0, 1.0, 6.0, 8.0)),
    "a normal density": (al.Density(bell, -np.inf, np.inf, location=27.6, scale=0.05), stats.norm(27.6, 0.05)),
    "a density on the half line": (al.Density(lambda x: x * np.exp(-x), 0.0, np.inf), stats.gamma(2.0)),
    "a density without bound at its end": (al.Density(lambda x: x**-0.5, 0, 1, location=3.0), stats.beta(0.5, 1, 3)),
}
CURVED = {
    "lognormal by moments": (al.LogNormal(mean=3.0, std=0.8), lognormal_by_moments(3.0, 0.8)),
    "lognormal above a bound": (al.LogNormal(log_mean=0.5, log_std=0.7, lower=-1), stats.lognorm(0.7, -1, np.exp(0.5))),
    "lognormal by median above a bound": (al.LogNormal(median=2.0, log_std=0.7, lower=-1), stats.lognorm(0.7, -1, 3)),
}
DISTRIBUTIONS = LINEAR | CURVED
# To find these quantiles takes an iteration: one of each is enough.
AT_NORMALS = ["beta by moments on an interval", *(n for n in DISTRIBUTIONS if not n.startswith(("beta", "gamma")))]


@pytest.fixture(scope="module")
def computed():
    """Of every distribution mean, standard deviation, support, and values at germs and normals, by one program."""

    @compiled
    def program(germs, normals):
        return {
            name: (
                *(one.mean(), one.std(), *one.support()),
                jax.vmap(one.value)(germs[name]),
                jax.vmap(one.value_at_normal)(normals) if name in AT_NORMALS else normals,
            )
            for name, (one, _) in DISTRIBUTIONS.items()
        }

    germs = {}
    for name, (distribution, _) in DISTRIBUTIONS.items():
        germ = distribution.germ()
        germs[name] = np.concatenate([germ.quantile(LEVELS), germ.gauss(3)[0]])
    return jax.tree.map(np.asarray, program(germs, NORMALS))


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_moments_support_and_values_are_those_of_scipy(computed, name):
    distribution, oracle = DISTRIBUTIONS[name]
    mean, std, low, high, values, at_normals = computed[name]
    assert mean == pytest.approx(oracle.mean(), rel=1e-11)
    # SciPy's variance loses digits in a tail, of which there is a test by quadrature below.
    assert std == pytest.approx(oracle.std(), rel=1e-6 if "tail" in name else 1e-10)
    assert (low, high) == pytest.approx(oracle.support(), rel=1e-13)
    assert values[: len(LEVELS)] == pytest.approx(oracle.ppf(LEVELS), rel=1e-11, abs=1e-12)
    if name in AT_NORMALS:
        expected = np.where(NORMALS < 0, oracle.ppf(stats.norm.cdf(NORMALS)), oracle.isf(stats.norm.sf(NORMALS)))
        assert at_normals == pytest.approx(expected, rel=1e-7, abs=1e-9)
    if name in LINEAR:  # a Gauss rule of three nodes integrates the fourth power
        _, weights = distribution.germ().gauss(3)
        for k in range(1, 5):
            assert weights @ values[len(LEVELS) :] ** k == pytest.approx(oracle.moment(k), rel=1e-9)
    germ, levels = distribution.germ(), np.array([[1e-6, 1e-3, 0.1], [0.5, 0.9, 1 - 1e-6]])
    assert germ.cumulative(germ.quantile(levels)) == pytest.approx(levels, rel=1e-9, abs=1e-10)
    low, high = germ.support()
    assert germ.cumulative(np.array([low - 1.0, low, high, high + 1.0])).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert low < germ.quantile(np.array(1e-6)) < germ.quantile(np.array(1 - 1e-6)) < high


MADE = {
    "lognormal": al.LogNormal(mean=3.0, std=0.8),
    "weibull": al.Weibull(mean=0.5, std=2.0),
    "gumbel": al.Gumbel(mean=3.0, std=0.3),
    "beta, nearly as wide as possible": al.Beta(mean=0.3, std=0.45),
}
IN_TAILS = [al.TruncatedNormal(0.0, 1.0, lower=30.0), al.TruncatedNormal(0.0, 1.0, lower=3.0, upper=3.0 + 1e-5)]


def test_distributions_by_moments_have_them_and_those_of_truncated_normals_keep_their_digits():
    nodes, weights = MADE["lognormal"].germ().gauss(30)

    @compiled
    def program(nodes):
        canonical = {name: MADE[name].canonical() for name in ("weibull", "gumbel")}
        moments = [(one.mean(), one.std()) for one in (*MADE.values(), *IN_TAILS)]
        return moments, canonical, jax.vmap(MADE["lognormal"].value)(nodes)

    found, canonical, values = jax.tree.map(np.asarray, program(nodes))
    for one, moments in zip(MADE.values(), found, strict=False):
        assert moments == pytest.approx((one.parameters["mean"], one.parameters["std"]), rel=1e-9)
    for name, (location, scale, shape) in canonical.items():
        oracle = stats.weibull_min(float(shape[0])) if shape else stats.gumbel_r()
        moments = location + scale * oracle.mean(), scale * oracle.std()
        assert moments == pytest.approx([MADE[name].parameters["mean"], MADE[name].parameters["std"]], rel=1e-8)
    assert weights @ values == pytest.approx(3.0, rel=1e-13)
    assert np.sqrt(weights @ (values - 3.0) ** 2) == pytest.approx(0.8, rel=1e-12)
    # Mills: beyond a, mean - a = 1/a - 2/a^3 + 10/a^5 - 74/a^7, variance = 1/a^2 - 6/a^4 + 50/a^6 - 518/a^8 + ...
    a, (mean, std), narrow = 30.0, *found[len(MADE) :]
    assert mean - a == pytest.approx(1 / a - 2 / a**3 + 10 / a**5 - 74 / a**7, rel=1e-8)
    assert std**2 == pytest.approx(1 / a**2 - 6 / a**4 + 50 / a**6 - 518 / a**8, rel=1e-6)
    # So narrow a part of the density is uniform.
    assert narrow == pytest.approx((3.0 + 5e-6, 1e-5 / np.sqrt(12)), rel=1e-5)


@pytest.mark.parametrize("data", [[1.02, 0.97, 1.05, 0.99, 1.01], [1.0, 1.0, 1.0, 5.0]])
def test_a_sample_has_the_moments_the_range_and_the_values_of_its_data(data):
    data, distribution = np.array(data), al.Sample(data, location=1.0, scale=2.0)
    assert float(distribution.mean()) == pytest.approx(1 + 2 * data.mean(), rel=1e-14)
    assert float(distribution.std()) == pytest.approx(2 * data.std(), rel=1e-14)
    assert tuple(map(float, distribution.support())) == pytest.approx((1 + 2 * data.min(), 1 + 2 * data.max()))
    count = 1000 * len(data)
    levels = (np.arange(count) + 0.5) / count  # each of the data at the same number of levels
    drawn = distribution.germ().quantile(levels)
    assert set(drawn) == set(data)
    assert (drawn.mean(), drawn.std()) == pytest.approx((data.mean(), data.std()), rel=1e-12)
    normals = stats.norm.ppf(levels[::100])
    by_normal = compiled(jax.vmap(lambda normal: distribution.from_normal(normal, ())))(normals)
    assert np.array_equal(by_normal, drawn[::100])
    assert distribution.germ() == al.Sample(data[::-1]).germ() != al.Sample([*data, 9.0]).germ()


def test_quantiles_of_a_sample_are_those_of_the_empirical_distribution():
    data = np.random.default_rng(4).normal(size=40).round(1)  # some of them alike
    germ = al.Sample(data).germ()
    levels = np.linspace(0.001, 0.999, 77)
    assert np.array_equal(germ.quantile(levels), np.quantile(data, levels, method="inverted_cdf"))
    between = np.linspace(-4.03, 4.03, 30)
    assert germ.cumulative(between) == pytest.approx(stats.ecdf(data).cdf.evaluate(between), abs=1e-15)
    at = np.unique(data)
    middle = [np.mean(data < one) + np.mean(data == one) / 2 for one in at]
    assert germ.cumulative(at) == pytest.approx(middle, abs=1e-15)
    assert np.array_equal(germ.quantile(germ.cumulative(at)), at)
