"""Christoffel and optimal points: conditioning at high order, weights, and the accuracy that comes of it."""

import numpy as np
import pytest

import aleator as al
from aleator.expansion import Basis, collocate
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, SampleGerm

NORMAL = {"n": HermiteGerm()}
MIXED = {"n": HermiteGerm(), "g": LaguerreGerm(2.0), "b": JacobiGerm(0.5, 0.5)}


def condition(germs, order, points):
    return float(collocate(germs, al.Expansion(order, points=points)).collocation.condition_number)


def test_hermite_polynomials_of_order_14_are_well_conditioned_where_quantiles_of_even_points_are_not():
    assert condition(NORMAL, 14, al.points.HammersleyPoints()) > 1e6
    for kind in (al.points.ChristoffelPoints, al.points.OptimalPoints):
        assert condition(NORMAL, 14, kind(seed=5)) < 10


def test_optimal_points_interpolate_where_even_points_are_nearly_singular():
    optimal, even = (
        collocate(MIXED, al.Expansion(5, points=points, fit=al.fits.Interpolation())).collocation
        for points in (al.points.OptimalPoints(), al.points.HammersleyPoints())
    )
    assert float(optimal.condition_number) < 100
    assert float(even.condition_number) > 1e4


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


def test_a_data_sample_of_few_values_has_points_too():
    germs = {"s": SampleGerm(np.linspace(0, 1, 9) ** 2), "n": HermiteGerm()}
    _, collocation = collocate(germs, al.Expansion(3, points=al.points.OptimalPoints()))
    assert float(collocation.condition_number) < 20
    values = np.asarray(collocation.points)[:, 0]
    assert np.all((values >= 0) & (values <= 1))


@pytest.mark.parametrize("points", [al.points.ChristoffelPoints(), al.points.OptimalPoints()])
def test_an_exponential_of_a_normal_number_has_its_coefficients_in_closed_form(points):
    # exp(x) = sqrt(e) times the sum of He_k(x) / k!, of norm sqrt(k!)
    _, collocation = collocate(NORMAL, al.Expansion(14, points=points))
    factorials = np.cumprod([1.0, *range(1, 15)])
    ours = collocation.coefficients(np.exp(np.asarray(collocation.points)[:, 0]))
    assert ours == pytest.approx(np.sqrt(np.e) / np.sqrt(factorials), abs=2e-5)
