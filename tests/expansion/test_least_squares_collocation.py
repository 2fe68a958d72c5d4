"""The collocation matrix, its condition and its coefficients against numpy and chaospy."""

import chaospy
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from aleator._core.errors import ProblemError
from aleator.expansion import Basis, Expansion, HammersleyPoints, LeastSquares, Nodes, TotalDegree, collocate
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

GERMS = {"a": LegendreGerm(), "b": HermiteGerm(), "c": JacobiGerm(2.0, 5.0), "d": LaguerreGerm(3.0)}
DISTRIBUTIONS = (stats.uniform(-1, 2), stats.norm(), stats.beta(2, 5, -1, 2), stats.gamma(3))
CHAOSPY = (chaospy.Uniform(-1, 1), chaospy.Normal(0, 1), chaospy.Beta(2, 5, -1, 1), chaospy.Gamma(3))
EXPANSION = Expansion(3, points=HammersleyPoints())


@pytest.fixture(scope="module")
def collocation():
    return collocate(GERMS, EXPANSION).collocation


@pytest.fixture(scope="module")
def chaospy_basis():
    """Chaospy's orthonormal polynomials, term by term in the order of our index set, leading coefficients positive."""
    univariate = [chaospy.expansion.stieltjes(EXPANSION.order, distribution, normed=True) for distribution in CHAOSPY]
    q = chaospy.variable(len(GERMS))
    moved = [one(q[i]) for i, one in enumerate(univariate)]
    return [
        np.prod([1, *(moved[i][degree] for i, degree in enumerate(row) if degree)])
        for row in TotalDegree().indices(tuple(GERMS), EXPANSION.order).tolist()
    ]


def nonlinear(points):
    x = np.asarray(points).T
    return np.exp(0.3 * x[0]) * np.sin(0.5 * x[1] + x[2]) + np.sqrt(1 + x[3])


def test_there_are_three_points_for_each_term_unless_told(collocation):
    assert collocation.matrix.shape == (3 * 35, 35)
    assert collocate(GERMS, Expansion(2, points=40)).collocation.matrix.shape == (40, 15)


def test_points_are_the_germs_quantiles_of_the_hammersley_set(collocation):
    count = 3 * 35
    halton = qmc.Halton(d=3, scramble=False).random(count + 1)[1:]
    levels = [(np.arange(count) + 0.5) / count, *halton.T]
    expected = np.stack(
        [distribution.ppf(level) for distribution, level in zip(DISTRIBUTIONS, levels, strict=True)], axis=1
    )
    assert collocation.points == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_the_matrix_holds_chaospys_orthonormal_polynomials_at_the_points(collocation, chaospy_basis):
    points = np.asarray(collocation.points)
    theirs = np.stack([np.ones(len(points)), *(np.asarray(p(*points.T)) for p in chaospy_basis[1:])], axis=1)
    assert collocation.matrix == pytest.approx(theirs, rel=1e-8, abs=1e-8)


def test_the_basis_is_orthonormal_under_the_joint_distribution_by_a_product_rule():
    basis = Basis(GERMS, TotalDegree().indices(tuple(GERMS), 3))
    rules = [germ.gauss(4) for germ in GERMS.values()]
    nodes = np.stack([axis.ravel() for axis in np.meshgrid(*(x for x, _ in rules), indexing="ij")], axis=1)
    weights = np.prod(np.meshgrid(*(w for _, w in rules), indexing="ij"), axis=0).ravel()
    matrix = basis.matrix(nodes)
    assert matrix.T @ (weights[:, None] * matrix) == pytest.approx(np.eye(35), abs=1e-11)


def test_the_condition_number_is_numpys(collocation):
    assert float(collocation.condition_number) == pytest.approx(np.linalg.cond(collocation.matrix), rel=1e-9)


def test_the_pseudo_inverse_is_numpys(collocation):
    pseudo_inverse = np.linalg.pinv(collocation.matrix)
    assert collocation.pseudo_inverse == pytest.approx(pseudo_inverse, rel=1e-8, abs=1e-10)


def test_the_leverage_is_the_diagonal_of_the_projection(collocation):
    projection = collocation.matrix @ np.linalg.pinv(collocation.matrix)
    assert collocation.leverage == pytest.approx(np.diag(projection), rel=1e-9)


def test_coefficients_are_those_of_numpys_least_squares(collocation):
    samples = nonlinear(collocation.points)
    expected = np.linalg.lstsq(np.asarray(collocation.matrix), samples, rcond=None)[0]
    assert collocation.coefficients(jnp.asarray(samples)) == pytest.approx(expected, rel=1e-8, abs=1e-10)


def test_coefficients_are_those_of_chaospys_regression(collocation, chaospy_basis):
    points = np.asarray(collocation.points)
    basis = chaospy.polynomial(chaospy_basis)
    _, theirs = chaospy.fit_regression(basis, points.T, nonlinear(points), retall=1)
    assert collocation.coefficients(jnp.asarray(nonlinear(points))) == pytest.approx(theirs, rel=1e-8, abs=1e-8)


def test_samples_may_have_any_shape(collocation):
    scalar = nonlinear(collocation.points)
    factors = np.arange(1.0, 7.0).reshape(2, 3)
    stacked = collocation.coefficients(jnp.asarray(scalar[:, None, None] * factors))
    expected = np.linalg.lstsq(np.asarray(collocation.matrix), scalar, rcond=None)[0][:, None, None] * factors
    assert stacked.shape == (35, 2, 3)
    assert stacked == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_polynomials_in_the_span_are_recovered_exactly(collocation):
    coefficients = np.random.default_rng(3).normal(size=(35, 4))
    samples = jnp.asarray(collocation.matrix @ coefficients)
    assert collocation.coefficients(samples) == pytest.approx(coefficients, rel=1e-10, abs=1e-11)


def test_the_identity_has_the_coefficients_of_equations_13_and_14():
    basis, collocation = collocate({"u": LegendreGerm(), "n": HermiteGerm()}, Expansion(2))
    uniform, normal = 5 + 2 * collocation.points[:, 0], 1 + 3 * collocation.points[:, 1]
    coefficients = np.asarray(collocation.coefficients(jnp.stack([uniform, normal], axis=1)))
    names = {tuple(row): k for k, row in enumerate(basis.indices.tolist())}
    assert coefficients[names[0, 0]] == pytest.approx([5, 1])
    # the orthonormal Legendre polynomial is sqrt(3) xi
    assert coefficients[names[1, 0]] == pytest.approx([2 / 3**0.5, 0], abs=1e-12)
    assert coefficients[names[0, 1]] == pytest.approx([0, 3], abs=1e-12)
    assert np.abs(coefficients[3:]).max() < 1e-12


def test_as_many_points_as_terms_interpolate():
    _, collocation = collocate({"u": LegendreGerm()}, Expansion(4, points=5))
    samples = jnp.exp(collocation.points[:, 0])
    again = collocation.matrix @ collocation.coefficients(samples)
    assert again == pytest.approx(np.asarray(samples), rel=1e-13)


def test_nothing_uncertain_takes_one_point_and_one_term():
    basis, collocation = collocate({}, Expansion(5, points=70))
    assert basis.indices.shape == (1, 0)
    assert collocation.points.shape == (1, 0)
    assert collocation.coefficients(jnp.array([[2.0, 3.0]])).tolist() == [[2.0, 3.0]]


def test_too_few_points_are_refused_with_the_number_to_take():
    with pytest.raises(
        ProblemError, match=r"10 terms in 2 variables .* received 9\. Use 3 \* 10 = 30 points or a lower order"
    ):
        collocate({"u": LegendreGerm(), "n": HermiteGerm()}, Expansion(3, points=9))


def test_a_singular_collocation_matrix_is_refused_with_a_remedy():
    with pytest.raises(ProblemError, match=r"condition number .*Use more points or a lower order"):
        collocate({"n": HermiteGerm()}, Expansion(40, points=41))


@pytest.mark.parametrize("order", [0, -1, True])
def test_an_order_that_is_no_positive_whole_number_is_refused(order):
    with pytest.raises(ProblemError, match="order is a whole number of at least 1; received"):
        Expansion(order)


@pytest.mark.parametrize("points", [0, -5, True])
def test_points_that_are_no_positive_whole_number_are_refused(points):
    with pytest.raises(ProblemError, match="points is a whole number of at least 1; received"):
        Expansion(2, points=points)


@pytest.mark.parametrize("wrong", [2.0, "3", [2]])
def test_an_expansion_counts_in_whole_numbers_only(wrong):
    # a ProblemError for users; under these tests the types of all arguments are checked even before
    for make in (lambda: Expansion(wrong), lambda: Expansion(2, points=wrong)):
        with pytest.raises((ProblemError, TypeError)):
            make()


def test_hammersley_points_fit_and_terms_are_those_of_the_dissertation_to_the_last_bit(collocation):
    # written out: QR of the matrix at three Hammersley points for each term, no weight in sight
    matrix = Basis(GERMS, TotalDegree().indices(tuple(GERMS), 3)).matrix(np.asarray(collocation.points))
    orthogonal, triangular = np.linalg.qr(matrix)
    assert np.array_equal(collocation.matrix, matrix)
    assert np.array_equal(collocation.pseudo_inverse, np.linalg.solve(triangular, orthogonal.T))


def test_hammersley_points_are_the_default_where_every_germ_is_bounded():
    germs = {"a": LegendreGerm(), "c": JacobiGerm(2.0, 5.0)}
    usual, even = (collocate(germs, Expansion(3, points=points)).collocation for points in (None, HammersleyPoints()))
    assert np.array_equal(usual.points, even.points)
    assert np.array_equal(usual.pseudo_inverse, even.pseudo_inverse)


@pytest.fixture(scope="module")
def weighted():
    basis = Basis(GERMS, TotalDegree().indices(tuple(GERMS), 2))
    weights = np.random.default_rng(7).uniform(0.1, 3.0, 45)
    points = HammersleyPoints(45).nodes(basis, 0).points
    return LeastSquares().collocation(basis, Nodes(points, weights / weights.sum()))


def test_weights_weigh_the_squares(weighted):
    matrix, roots = np.asarray(weighted.matrix), np.sqrt(np.asarray(weighted.weights))
    samples = nonlinear(weighted.points)
    expected = np.linalg.lstsq(matrix * roots[:, None], samples * roots, rcond=None)[0]
    assert weighted.coefficients(jnp.asarray(samples)) == pytest.approx(expected, rel=1e-8, abs=1e-10)


def test_with_weights_the_leverage_is_still_the_diagonal_of_the_map_to_fitted_values(weighted):
    fitted = np.asarray(weighted.matrix) @ np.asarray(weighted.pseudo_inverse)
    assert weighted.leverage == pytest.approx(np.diag(fitted), rel=1e-9)


def test_weights_that_are_not_positive_are_refused_with_a_remedy():
    basis = Basis(GERMS, TotalDegree().indices(tuple(GERMS), 1))
    points = HammersleyPoints(10).nodes(basis, 0).points
    with pytest.raises(ProblemError, match=r"weights that are not positive.*al\.fits\.Projection"):
        LeastSquares().collocation(basis, Nodes(points, np.array([-1.0, *[2 / 9] * 9])))


def test_a_discretisation_says_what_it_holds():
    ready = collocate({"u": LegendreGerm(), "n": HermiteGerm()}, Expansion(2))
    assert ready.order == 2
    assert str(ready).startswith("order 2, 6 terms, 18 points, condition number ")


def test_an_expansion_says_what_is_wished():
    germs = {"u": LegendreGerm(), "v": LegendreGerm()}
    assert (
        Expansion(4).text(germs) == "order 4 in 2 variables, TotalDegree index set, HammersleyPoints, LeastSquares fit"
    )
