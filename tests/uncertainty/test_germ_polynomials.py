"""The germ distributions and their orthonormal polynomials against scipy's weights and scipy.stats."""

import numpy as np
import pytest
from scipy import integrate, special, stats

from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

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
