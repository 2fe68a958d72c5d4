"""Germs and their orthonormal polynomials, in closed form, of densities and of data, against scipy."""

import numpy as np
import pytest
from scipy import integrate, special, stats

import aleator as al
from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    DensityGerm,
    GumbelGerm,
    HermiteGerm,
    JacobiGerm,
    LaguerreGerm,
    LegendreGerm,
    SampleGerm,
    TriangularGerm,
    TruncatedNormalGerm,
    WeibullGerm,
)

EPS = np.finfo(float).eps
SHAPES = [(2.0, 5.0), (0.3, 0.7)]


def jacobi_expectation(alpha, beta):
    """QUADPACK's rule for end points with powers: scipy's `roots_jacobi` divides by zero for alpha + beta = 1."""

    def integral(function):
        return integrate.quad(function, -1, 1, weight="alg", wvar=(alpha - 1, beta - 1), epsabs=1e-12)[0]

    return lambda function: integral(function) / integral(lambda _: 1.0)


def rule_expectation(nodes, weights):
    return lambda function: np.sum([w * function(x) for x, w in zip(nodes, weights, strict=True)]) / np.sum(weights)


# germ, scipy's distribution, independent expectation
CASES = {
    "legendre": (
        LegendreGerm(),
        stats.uniform(-1, 2),
        rule_expectation(*special.roots_legendre(24)),
    ),
    "hermite": (
        HermiteGerm(),
        stats.norm(),
        rule_expectation(*special.roots_hermitenorm(24)),
    ),
}
CASES |= {
    f"jacobi-{a}-{b}": (
        JacobiGerm(a, b),
        stats.beta(a, b, -1, 2),
        jacobi_expectation(a, b),
    )
    for a, b in SHAPES
}
CASES |= {
    f"laguerre-{s}": (
        LaguerreGerm(s),
        stats.gamma(s),
        rule_expectation(*special.roots_genlaguerre(24, s - 1)),
    )
    for s in (0.4, 9.0)
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    return request.param


def test_polynomials_are_orthonormal_under_their_own_distribution_and_lead_with_a_positive_sign(case):
    germ, distribution, expectation = case

    def product(i, j):
        return lambda x: np.prod(germ.polynomials(8, np.array([x]))[0, [i, j]])

    gram = [[expectation(product(i, j)) for i in range(j + 1)] for j in range(9)]
    for j, row in enumerate(gram):
        assert row == pytest.approx([0.0] * j + [1.0], abs=1e-9)
    assert np.all(germ.polynomials(8, np.array([distribution.ppf(1 - 1e-3) + 100.0])) > 0)
    assert germ.polynomials(0, distribution.ppf([0.1, 0.9])).tolist() == [[1.0], [1.0]]
    levels = np.linspace(0.001, 0.999, 41).reshape(1, 41)
    assert germ.quantile(levels) == pytest.approx(distribution.ppf(levels), rel=1e-11, abs=1e-11)


def test_the_gauss_rule_is_exact_to_degree_two_n_minus_one_and_no_further(case):
    germ, _, expectation = case
    for count in (1, 2, 5, 8):
        nodes, weights = germ.gauss(count)
        assert weights.sum() == pytest.approx(1.0, rel=100 * EPS)
        for degree in range(2 * count):
            exact, size = expectation(lambda x, d=degree: x**d), weights @ np.abs(nodes) ** degree
            assert weights @ nodes**degree == pytest.approx(exact, abs=1e-10 * size + 1e-14)
    nodes, weights = germ.gauss(3)
    exact = expectation(lambda x: x**6)
    assert abs(weights @ nodes**6 - exact) > 1e-4 * exact


ORDER = 30

# closed form, its density as a user may write it, with its bounds
CLOSED = {
    "hermite": (HermiteGerm(), lambda x: np.exp(-(x**2) / 2), -np.inf, np.inf),
    "laguerre, singular": (LaguerreGerm(0.3), lambda x: x**-0.7 * np.exp(-x), 0, np.inf),
    "jacobi": (JacobiGerm(2.5, 4.0), lambda x: (1 + x) ** 1.5 * (1 - x) ** 3, -1, 1),
}


@pytest.mark.parametrize(("closed", "density", "low", "high"), CLOSED.values(), ids=CLOSED.keys())
def test_the_recurrence_of_a_density_is_that_of_the_closed_form(closed, density, low, high):
    for ours, exact in zip(DensityGerm(density, low, high).recurrence(ORDER), closed.recurrence(ORDER), strict=True):
        assert ours == pytest.approx(exact, rel=1e-13, abs=1e-13 * np.max(np.abs(exact)) + 1e-14)


def test_a_narrow_peak_that_holds_most_of_a_density_is_found():
    centre, width = 0.91234, 1e-5
    # A uniform density, and a normal one of √π times its mass.
    germ = DensityGerm(lambda x: 1 + np.exp(-(((x - centre) / width) ** 2)) / width, 0.0, 1.0)
    a, b = germ.recurrence(1)
    mass, mean = np.sqrt(np.pi), (0.5 + np.sqrt(np.pi) * centre) / (1 + np.sqrt(np.pi))
    square = (1 / 3 + mass * (centre**2 + width**2 / 2)) / (1 + mass)
    assert a[0] == pytest.approx(mean, rel=1e-12)
    assert b[1] == pytest.approx(np.sqrt(square - mean**2), rel=1e-10)


# germ, SciPy's distribution
GERMS = {
    "triangular": (TriangularGerm(0.3), stats.triang(0.3, -1, 2)),
    "truncated normal": (TruncatedNormalGerm(-1.0, 2.5), stats.truncnorm(-1, 2.5)),
    "weibull, singular": (WeibullGerm(0.7), stats.weibull_min(0.7)),
    "gumbel": (GumbelGerm(), stats.gumbel_r()),
}


@pytest.mark.parametrize(("germ", "distribution"), GERMS.values(), ids=GERMS.keys())
def test_polynomials_are_orthonormal_under_scipys_density(germ, distribution):
    # independent of the germ's own quadrature: many equal panels in a power of the coordinate, with a break at -0.4
    low, high = max(germ.support()[0], -40.0), min(germ.support()[1], 4000.0 if germ == WeibullGerm(0.7) else 150.0)
    power = 8 if low == 0 else 1
    kink = (np.clip(-0.4, low, high) - low) / (high - low)
    edges = np.unique(np.concatenate([np.linspace(0, 1, 3000), [kink]]))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    s, w = ((np.diff(edges)[:, None] / 2 * rule).ravel() for rule in (nodes, weights))
    s += np.repeat((edges[:-1] + edges[1:]) / 2, nodes.size)
    x = low + (high - low) * s**power
    mass = w * distribution.pdf(x) * (high - low) * power * s ** (power - 1)
    values = germ.polynomials(12, x)
    assert (values.T * mass) @ values == pytest.approx(np.eye(13), abs=1e-10)


def test_a_density_with_kinks_and_jumps_has_the_moments_of_its_pieces():
    germ = DensityGerm(lambda x: np.exp(-3 * x) + (x > 0.3) + 2.0 * np.maximum(0.8 - x, 0), 0.0, 1.0)
    nodes, weights = germ.gauss(12)
    mass = (1 - np.exp(-3)) / 3 + 0.7 + 0.64
    mean = (1 - 4 * np.exp(-3)) / 9 + (1 - 0.09) / 2 + 2 * (0.8**3 / 2 - 0.8**3 / 3)
    assert weights @ nodes == pytest.approx(mean / mass, rel=1e-12)
    assert germ.cumulative(np.array(0.3)) == pytest.approx(
        ((1 - np.exp(-0.9)) / 3 + 2 * (0.8 * 0.3 - 0.045)) / mass, rel=1e-12
    )
    values = germ.polynomials(10, nodes)
    assert (values.T * weights) @ values == pytest.approx(np.eye(11), abs=1e-12)


# A density that is zero between its bounds, and its first and second moments over its integral.
ZEROS = {
    "hat": (lambda x: np.maximum(0, 1 - np.abs(x)), -2.0, 2.0, (0.0, 1 / 6)),
    "kink": (lambda x: np.abs(x - 0.3), 0.0, 1.0, (0.577 / 0.87, 0.15135 / 0.29)),
}


@pytest.mark.parametrize(("density", "low", "high", "moments"), ZEROS.values(), ids=ZEROS)
def test_a_density_may_touch_zero_between_its_bounds(density, low, high, moments):
    a, b = DensityGerm(density, low, high).recurrence(ORDER)
    assert (a[0], a[0] ** 2 + b[1] ** 2) == pytest.approx(moments, rel=1e-13, abs=1e-14)
    assert np.all(b[1:] > 0)


def test_a_tail_that_carries_few_moments_carries_few_polynomials():
    germ = DensityGerm(lambda x: (1 + x**2 / 7) ** -4, -np.inf, np.inf)  # Student's t with 7 degrees of freedom
    _, b = germ.recurrence(2)
    assert b[1] == pytest.approx(np.sqrt(7 / 5), rel=1e-9)
    with pytest.raises(ProblemError, match=r"decays too slowly for polynomials of order 4.*Bound the density"):
        germ.recurrence(4)


def test_polynomials_of_a_sample_are_orthonormal_under_the_data_up_to_the_last_order():
    data = np.round(np.random.default_rng(5).lognormal(sigma=0.4, size=60), 1)
    germ = SampleGerm(data)
    highest = min(np.unique(data).size - 1, 12)
    values = germ.polynomials(highest, data)
    assert values.T @ values / data.size == pytest.approx(np.eye(highest + 1), abs=1e-10)


def test_a_sample_of_n_values_is_its_own_gauss_rule_of_n_points():
    data = np.array([0.1, 0.5, 0.6, 2.0, 2.5])
    nodes, weights = SampleGerm(data).gauss(5)
    assert nodes == pytest.approx(data, rel=1e-12)
    assert weights == pytest.approx(np.full(5, 0.2), rel=1e-12)
    with pytest.raises(ProblemError, match="5 distinct values carries polynomials up to order 4; received order 5"):
        SampleGerm(data).recurrence(5)
    few, other = al.Sample([0.0, 1.0, 3.0]), al.Normal(0.0, 1.0)
    for points in (None, al.points.InducedPoints(), al.points.SmolyakPoints()):
        chosen = {} if points is None else {"points": points}
        with pytest.raises(ProblemError, match="3 distinct values carries polynomials up to order 2"):
            al.expand(lambda one: one["x"] + one["y"], {"x": few, "y": other}, al.Expansion(order=3, **chosen))
