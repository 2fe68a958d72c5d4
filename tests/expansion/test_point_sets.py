"""Point sets in the unit cube against scipy's, closed forms and what they promise, in many variables too."""

import math

import chaospy
import numpy as np
import pytest
from scipy.stats import norm, qmc

import aleator as al
from aleator.expansion import (
    Basis,
    ChristoffelPoints,
    HaltonPoints,
    HammersleyPoints,
    LatinHypercubePoints,
    OptimalPoints,
    RandomPoints,
    SobolPoints,
    TotalDegree,
    collocate,
)
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

EVEN = [HammersleyPoints(), HaltonPoints(), SobolPoints(), LatinHypercubePoints(), RandomPoints()]
SEEDED = [SobolPoints, LatinHypercubePoints, RandomPoints, ChristoffelPoints, OptimalPoints]


def test_the_halton_sequence_is_scipys_without_the_origin_and_the_hammersley_set_has_it_beside_an_even_column():
    halton = qmc.Halton(d=5, scramble=False).random(51)[1:]
    points = HammersleyPoints().levels(50, 6)
    assert points[:, 0] == pytest.approx((np.arange(50) + 0.5) / 50, rel=1e-15)
    assert points[:, 1:] == pytest.approx(halton, rel=1e-13)
    assert HaltonPoints().levels(50, 5) == pytest.approx(halton, rel=1e-13)


def test_scrambled_sobol_points_fill_every_elementary_interval():
    # 2^6 points of a (0, 6, 2)-net in base 2: one in each of 64 boxes, however 64 is split
    points = SobolPoints(seed=3).levels(64, 2)
    for split in ((64, 1), (1, 64), (2, 32), (8, 8), (16, 4)):
        boxes = np.floor(points * np.array(split)).astype(int)
        assert len(np.unique(boxes, axis=0)) == 64


def test_a_latin_hypercube_has_one_point_in_each_slice_of_each_variable():
    slices = np.floor(LatinHypercubePoints(seed=4).levels(37, 5) * 37).astype(int)
    assert all(sorted(column) == list(range(37)) for column in slices.T.tolist())


@pytest.mark.parametrize("points", EVEN)
def test_points_lie_strictly_inside_the_unit_cube_none_twice_and_are_the_germs_quantiles_of_equal_weight(points):
    levels = points.levels(64, 12)
    assert levels.shape == (64, 12)
    assert np.all((levels > 0) & (levels < 1))
    assert all(len(np.unique(column)) == 64 for column in levels.T)
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, np.zeros((1, 2), dtype=int))
    nodes, levels = points.nodes(basis, 32), points.levels(32, 2)
    assert nodes.weights == pytest.approx(np.full(32, 1 / 32), rel=1e-15)
    np.testing.assert_allclose(
        nodes.points, np.stack([2 * levels[:, 0] - 1, norm.ppf(levels[:, 1])], axis=1), rtol=1e-11
    )
    if points.nested:
        assert np.array_equal(points.nodes(basis, 100).points[:32], nodes.points)


@pytest.mark.parametrize(("points", "slope"), [(RandomPoints, -0.5), (SobolPoints, -1.5)])
def test_means_converge_at_the_known_rates(points, slope):
    # Owen (1997): scrambled nets integrate smooth functions to n^-1.5, but for logarithms
    counts = 2 ** np.arange(4, 12)

    def error(count):
        means = [np.prod(1 + 0.5 * (points(seed=s).levels(count, 3) - 0.5), axis=1).mean() for s in range(20)]
        return np.sqrt(np.mean((np.array(means) - 1) ** 2))

    fitted = np.polyfit(np.log(counts), np.log([error(count) for count in counts]), 1)[0]
    assert fitted == pytest.approx(slope, abs=0.2)


@pytest.mark.parametrize("kind", SEEDED)
def test_a_seed_gives_the_same_points_again_and_another_one_others(kind):
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, TotalDegree().indices(("u", "n"), 2))
    first, again, other = (kind(10, seed=seed).nodes(basis, 0).points for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.any(first == other)


DISTRIBUTIONS = {"uniform": al.Uniform.bounds(1.0, 3.0), "normal": al.Normal(2.0, 0.5)}
STDS = {"uniform": 1 / math.sqrt(3), "normal": 0.5}


@pytest.mark.parametrize(("kind", "variables", "order"), [("normal", 12, 2), ("uniform", 50, 1)])
def test_a_linear_function_of_many_variables_is_expanded_to_rounding_at_a_small_condition_number(
    kind, variables, order
):
    model = {f"x{i}": DISTRIBUTIONS[kind] for i in range(variables)}
    expanded = al.expand(lambda at: sum(at.values()), model, al.Expansion(order))
    assert float(expanded.mean) == pytest.approx(2.0 * variables, rel=1e-12)
    assert float(expanded.std) == pytest.approx(STDS[kind] * math.sqrt(variables), rel=1e-12)
    assert float(expanded.collocation.condition_number) < 6.0


# --- Christoffel and optimal points -----------------------------------------------------------------------------------


NORMAL = {"n": HermiteGerm()}
MIXED = {"n": HermiteGerm(), "g": LaguerreGerm(2.0), "b": JacobiGerm(0.5, 0.5)}


def condition(germs, order, points):
    return float(collocate(germs, al.Expansion(order, points=points)).collocation.condition_number)


def test_hermite_polynomials_of_order_14_are_well_conditioned_where_quantiles_of_even_points_are_not():
    assert condition(NORMAL, 14, al.points.HammersleyPoints()) > 1e6
    for kind in (al.points.ChristoffelPoints, al.points.OptimalPoints):
        assert condition(NORMAL, 14, kind(seed=5)) < 10


@pytest.mark.parametrize("points", [al.points.ChristoffelPoints(50), al.points.OptimalPoints(50)])
def test_weights_are_the_reciprocals_of_the_christoffel_function(points):
    basis = Basis(MIXED, al.index_sets.TotalDegree().indices(tuple(MIXED), 3))
    nodes = points.nodes(basis, 0)
    product = nodes.weights * np.sum(basis.matrix(nodes.points) ** 2, axis=1)
    assert product == pytest.approx(np.full(50, product[0]), rel=1e-10)
    assert nodes.weights.sum() == pytest.approx(1, rel=1e-12)


def test_christoffel_points_have_the_density_that_their_weights_undo():
    # So the weighted Gram matrix tends to the identity, as the inverse root of the number of points.
    basis = Basis(MIXED, al.index_sets.TotalDegree().indices(tuple(MIXED), 4))
    nodes = al.points.ChristoffelPoints(40_000, seed=2).nodes(basis, 0)
    matrix = basis.matrix(nodes.points)
    gram = matrix.T @ (nodes.weights[:, None] * matrix)
    assert np.linalg.norm(gram - np.eye(basis.terms), 2) < 3 * np.sqrt(basis.terms / len(matrix))


@pytest.mark.parametrize("points", [al.points.ChristoffelPoints(), al.points.OptimalPoints()])
def test_an_exponential_of_a_normal_number_has_its_coefficients_in_closed_form(points):
    # exp(x) = sqrt(e) times the sum of He_k(x) / k!, of norm sqrt(k!)
    _, collocation = collocate(NORMAL, al.Expansion(14, points=points))
    factorials = np.cumprod([1.0, *range(1, 15)])
    ours = collocation.coefficients(np.exp(np.asarray(collocation.points)[:, 0]))
    assert ours == pytest.approx(np.sqrt(np.e) / np.sqrt(factorials), abs=2e-5)


# --- Full and sparse grids of Gauss points ----------------------------------------------------------------------------


GERMS = {"u": LegendreGerm(), "n": HermiteGerm(), "b": JacobiGerm(2.0, 5.0), "g": LaguerreGerm(3.0)}
CHAOSPY = (chaospy.Uniform(-1, 1), chaospy.Normal(0, 1), chaospy.Beta(2, 5, -1, 1), chaospy.Gamma(3))


def beta_moment(d):
    """Of `2 B - 1`, where the moments of `B` with parameters 2 and 5 are products of `(2 + k) / (7 + k)`."""
    moments = [math.prod((2 + k) / (7 + k) for k in range(j)) for j in range(d + 1)]
    return sum(math.comb(d, j) * 2**j * (-1) ** (d - j) * moments[j] for j in range(d + 1))


MOMENTS = (
    lambda d: (d + 1) % 2 / (d + 1),
    lambda d: (d + 1) % 2 * math.prod(range(1, d, 2)),
    beta_moment,
    lambda d: math.factorial(d + 2) / 2,
)


def constant_basis(order):
    return Basis(GERMS, al.index_sets.TotalDegree().indices(tuple(GERMS), order))


def integral_errors(nodes, degrees):
    """Errors of the rule on monomials against the distributions' moments in closed form, relative to the terms of
    its sum.
    """
    errors = []
    for row in degrees:
        expected = math.prod(moment(d) for moment, d in zip(MOMENTS, row.tolist(), strict=True))
        values = np.prod(nodes.points**row, axis=1)
        size = max(abs(expected), np.abs(nodes.weights) @ np.abs(values), 1.0)
        errors.append(abs(nodes.weights @ values - expected) / size)
    return np.array(errors)


def test_a_full_grid_integrates_every_monomial_up_to_degree_2n_minus_1_in_each_variable_and_no_further():
    nodes = al.points.GaussPoints(3).nodes(constant_basis(1), 0)
    assert len(nodes.points) == 3**4
    inside = np.indices((6,) * 4).reshape(4, -1).T
    assert integral_errors(nodes, inside).max() < 1e-12
    assert integral_errors(nodes, 6 * np.eye(4, dtype=int)).min() > 1e-3


def test_a_sparse_grid_integrates_every_monomial_up_to_total_degree_2l_plus_1_and_no_further():
    nodes = al.points.SmolyakPoints(3).nodes(constant_basis(1), 0)
    assert integral_errors(nodes, al.index_sets.TotalDegree().indices(tuple(GERMS), 7)).max() < 1e-12
    assert integral_errors(nodes, 8 * np.eye(4, dtype=int)).min() > 1e-4


def test_projected_coefficients_are_those_of_chaospys_quadrature():
    germs, distributions = {"u": LegendreGerm(), "n": HermiteGerm()}, CHAOSPY[:2]

    def model(points):
        return np.exp(0.3 * points[0]) * np.sin(0.5 * points[1])

    basis, collocation = collocate(germs, al.Expansion(3, points=al.points.GaussPoints(4), fit=al.fits.Projection()))
    nodes, weights = chaospy.generate_quadrature(3, chaospy.J(*distributions), rule="gaussian")
    q = chaospy.variable(2)
    univariate = [chaospy.expansion.stieltjes(3, distribution, normed=True) for distribution in distributions]
    left, right = (one(q[i]) for i, one in enumerate(univariate))
    polynomials = [left[i] * right[j] for i, j in basis.indices.tolist()]
    _, theirs = chaospy.fit_quadrature(chaospy.polynomial(polynomials), nodes, weights, model(nodes), retall=1)
    ours = collocation.coefficients(model(np.asarray(collocation.points).T))
    assert ours == pytest.approx(theirs, rel=1e-8, abs=1e-8)


def test_a_rule_that_does_not_integrate_the_products_is_refused_with_one_that_does():
    for points in (al.points.SmolyakPoints(2), al.points.HammersleyPoints()):
        with pytest.raises(al.ProblemError, match=r"GaussPoints\(4\) or al\.points\.SmolyakPoints\(3\)"):
            collocate(GERMS, al.Expansion(3, points=points, fit=al.fits.Projection()))
    for better in (al.points.GaussPoints(4), al.points.SmolyakPoints(3)):
        collocate(GERMS, al.Expansion(3, points=better, fit=al.fits.Projection()))
