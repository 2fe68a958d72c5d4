"""The germ distributions and their orthonormal polynomials against scipy's weights, scipy.stats and chaospy."""

import chaospy
import numpy as np
import pytest
from scipy import integrate, special, stats

from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

EPS = np.finfo(float).eps
SHAPES = [(2.0, 5.0), (0.5, 0.5), (0.3, 0.7), (3.5, 0.6)]


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
    for s in (0.4, 1.0, 9.0)
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    return request.param


def test_polynomials_are_orthonormal_under_their_own_distribution_and_lead_with_a_positive_sign(case):
    germ, distribution, _, expectation = case

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
    germ, _, _, expectation = case
    for count in (1, 2, 5, 8):
        nodes, weights = germ.gauss(count)
        assert weights.sum() == pytest.approx(1.0, rel=100 * EPS)
        for degree in range(2 * count):
            exact, size = expectation(lambda x, d=degree: x**d), weights @ np.abs(nodes) ** degree
            assert weights @ nodes**degree == pytest.approx(exact, abs=1e-10 * size + 1e-14)
    nodes, weights = germ.gauss(3)
    exact = expectation(lambda x: x**6)
    assert abs(weights @ nodes**6 - exact) > 1e-4 * exact


def test_polynomials_and_gauss_rules_agree_with_chaospys(case):
    germ, distribution, oracle, _ = case
    points = distribution.ppf(np.linspace(0.02, 0.98, 13))
    basis = chaospy.expansion.stieltjes(5, oracle, normed=True)
    ours, theirs = germ.polynomials(5, points), np.array(basis(points)).T
    assert ours == pytest.approx(theirs * np.sign(theirs[-1] * ours[-1]), rel=1e-7, abs=1e-7)
    nodes, weights = chaospy.generate_quadrature(6, oracle, rule="gaussian")
    ours, order = germ.gauss(7), np.argsort(nodes[0])
    assert ours[0] == pytest.approx(nodes[0][order], rel=1e-7, abs=1e-8)
    assert ours[1] == pytest.approx(weights[order], rel=1e-6)


def test_legendre_and_hermite_polynomials_are_scipys_normed():
    points = np.linspace(-1, 1, 9)
    legendre = np.stack([np.sqrt(2 * n + 1) * special.eval_legendre(n, points) for n in range(9)], axis=1)
    assert LegendreGerm().polynomials(8, points) == pytest.approx(legendre, rel=1e-12, abs=1e-12)
    assert JacobiGerm(1.0, 1.0).polynomials(8, points) == pytest.approx(legendre, rel=1e-12, abs=1e-12)
    hermite = [special.eval_hermitenorm(n, 4 * points) / np.sqrt(special.factorial(n)) for n in range(9)]
    assert HermiteGerm().polynomials(8, 4 * points) == pytest.approx(np.stack(hermite, axis=1), rel=1e-12, abs=1e-12)
