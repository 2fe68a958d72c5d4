"""The germ distributions and their orthonormal polynomials against scipy's weights, scipy.stats and chaospy."""

import chaospy
import numpy as np
import pytest
from scipy import integrate, special, stats

from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

EPS = np.finfo(float).eps
SHAPES = [(2.0, 5.0), (1.0, 1.0), (0.5, 0.5), (0.3, 0.7), (0.25, 0.75), (3.5, 0.6), (7.0, 7.0), (0.2, 0.2)]


def jacobi_expectation(alpha, beta):
    """QUADPACK's rule for end points with powers: scipy's `roots_jacobi` divides by zero for alpha + beta = 1."""

    def integral(function):
        return integrate.quad(function, -1, 1, weight="alg", wvar=(alpha - 1, beta - 1), epsabs=1e-12)[0]

    return lambda function: integral(function) / integral(lambda _: 1.0)


def rule_expectation(nodes, weights):
    return lambda function: np.sum([w * function(x) for x, w in zip(nodes, weights, strict=True)]) / np.sum(weights)


# germ, scipy's distribution, chaospy's distribution, independent expectation
CASES = {
    "legendre": (
        LegendreGerm(),
        stats.uniform(-1, 2),
        chaospy.Uniform(-1, 1),
        rule_expectation(*special.roots_legendre(24)),
    ),
    "hermite": (
        HermiteGerm(),
        stats.norm(),
        chaospy.Normal(0, 1),
        rule_expectation(*special.roots_hermitenorm(24)),
    ),
}
CASES |= {
    f"jacobi-{a}-{b}": (
        JacobiGerm(a, b),
        stats.beta(a, b, -1, 2),
        chaospy.Beta(a, b, -1, 1),
        jacobi_expectation(a, b),
    )
    for a, b in SHAPES
}
CASES |= {
    f"laguerre-{s}": (
        LaguerreGerm(s),
        stats.gamma(s),
        chaospy.Gamma(s),
        rule_expectation(*special.roots_genlaguerre(24, s - 1)),
    )
    for s in (0.4, 1.0, 2.5, 9.0)
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    return request.param


def test_polynomials_are_orthonormal_under_their_own_distribution(case):
    germ, _, _, expectation = case

    def product(i, j):
        return lambda x: np.prod(germ.polynomials(8, np.array([x]))[0, [i, j]])

    gram = [[expectation(product(i, j)) for i in range(j + 1)] for j in range(9)]
    for j, row in enumerate(gram):
        assert row == pytest.approx([0.0] * j + [1.0], abs=1e-9)


def test_polynomials_agree_with_those_of_chaospy(case):
    germ, distribution, oracle, _ = case
    points = distribution.ppf(np.linspace(0.02, 0.98, 13))
    basis = chaospy.expansion.stieltjes(5, oracle, normed=True)
    ours, theirs = germ.polynomials(5, points), np.array(basis(points)).T
    assert ours == pytest.approx(theirs * np.sign(theirs[-1] * ours[-1]), rel=1e-7, abs=1e-7)


def test_polynomials_have_a_positive_leading_coefficient(case):
    germ, distribution, _, _ = case
    beyond_all_roots = np.array([distribution.ppf(1 - 1e-3) + 100.0])
    assert np.all(germ.polynomials(8, beyond_all_roots) > 0)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_the_gauss_rule_is_exact_to_degree_two_n_minus_one(case, count):
    germ, _, _, expectation = case
    nodes, weights = germ.gauss(count)
    assert weights.sum() == pytest.approx(1.0, rel=100 * EPS)
    for degree in range(2 * count):
        size = weights @ np.abs(nodes) ** degree
        assert weights @ nodes**degree == pytest.approx(expectation(lambda x, d=degree: x**d), abs=1e-10 * size + 1e-14)


def test_the_gauss_rule_is_not_exact_to_degree_two_n(case):
    germ, _, _, expectation = case
    nodes, weights = germ.gauss(3)
    exact = expectation(lambda x: x**6)
    assert abs(weights @ nodes**6 - exact) > 1e-4 * exact


def test_gauss_nodes_and_weights_agree_with_chaospys_golub_welsch(case):
    germ, _, oracle, _ = case
    nodes, weights = chaospy.generate_quadrature(6, oracle, rule="gaussian")
    ours, theirs = germ.gauss(7), np.argsort(nodes[0])
    assert ours[0] == pytest.approx(nodes[0][theirs], rel=1e-7, abs=1e-8)
    assert ours[1] == pytest.approx(weights[theirs], rel=1e-6)


def test_quantiles_agree_with_scipy_stats(case):
    germ, distribution, _, _ = case
    levels = np.linspace(0.001, 0.999, 41).reshape(1, 41)
    assert germ.quantile(levels) == pytest.approx(distribution.ppf(levels), rel=1e-11, abs=1e-11)


def test_the_polynomial_of_order_zero_is_one(case):
    germ, distribution, _, _ = case
    assert germ.polynomials(0, distribution.ppf([0.1, 0.9])).tolist() == [[1.0], [1.0]]


def test_jacobi_with_unit_shapes_is_legendre():
    points = np.linspace(-1, 1, 9)
    legendre = LegendreGerm().polynomials(7, points)
    assert JacobiGerm(1.0, 1.0).polynomials(7, points) == pytest.approx(legendre, rel=1e-12, abs=1e-12)


def test_legendre_polynomials_are_scipys_times_the_root_of_two_n_plus_one():
    points = np.linspace(-1, 1, 9)
    closed = np.stack([np.sqrt(2 * n + 1) * special.eval_legendre(n, points) for n in range(9)], axis=1)
    assert LegendreGerm().polynomials(8, points) == pytest.approx(closed, rel=1e-12, abs=1e-12)


def test_hermite_polynomials_are_scipys_over_the_root_of_n_factorial():
    points = np.linspace(-4, 4, 9)
    closed = np.stack([special.eval_hermitenorm(n, points) / np.sqrt(special.factorial(n)) for n in range(9)], axis=1)
    assert HermiteGerm().polynomials(8, points) == pytest.approx(closed, rel=1e-12, abs=1e-12)
