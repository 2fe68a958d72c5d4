"""The collocation matrix, its condition and its coefficients against numpy."""

import numpy as np
import pytest

from aleator._core.errors import ProblemError
from aleator.expansion import Basis, Expansion, HammersleyPoints, LeastSquares, Nodes, TotalDegree, collocate
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

GERMS = {"a": LegendreGerm(), "b": HermiteGerm(), "c": JacobiGerm(2.0, 5.0), "d": LaguerreGerm(3.0)}
EXPANSION = Expansion(3, points=HammersleyPoints())


@pytest.fixture(scope="module")
def collocation():
    return collocate(GERMS, EXPANSION).collocation


def nonlinear(points):
    x = np.asarray(points).T
    return np.exp(0.3 * x[0]) * np.sin(0.5 * x[1] + x[2]) + np.sqrt(1 + x[3])


def test_there_are_three_points_for_each_term_unless_told(collocation):
    assert collocation.matrix.shape == (3 * 35, 35)
    assert collocate(GERMS, Expansion(2, points=40)).collocation.matrix.shape == (40, 15)


def test_nothing_uncertain_takes_one_point_and_one_term():
    basis, collocation = collocate({}, Expansion(5, points=70))
    assert basis.indices.shape == (1, 0)
    assert collocation.points.shape == (1, 0)
    assert collocation.coefficients(np.array([[2.0, 3.0]])).tolist() == [[2.0, 3.0]]


def test_too_few_points_are_refused_with_the_number_to_take():
    with pytest.raises(
        ProblemError, match=r"10 terms in 2 variables .* received 9\. Use 3 \* 10 = 30 points or a lower order"
    ):
        collocate({"u": LegendreGerm(), "n": HermiteGerm()}, Expansion(3, points=9))


def test_weights_weigh_the_squares_and_the_leverage_is_the_diagonal_of_the_map_to_fitted_values():
    basis = Basis(GERMS, TotalDegree().indices(tuple(GERMS), 2))
    weights = np.random.default_rng(7).uniform(0.1, 3.0, 45)
    nodes = Nodes(HammersleyPoints(45).nodes(basis, 0).points, weights / weights.sum())
    weighted = LeastSquares().collocation(basis, nodes)
    matrix, roots = np.asarray(weighted.matrix), np.sqrt(np.asarray(weighted.weights))
    samples = nonlinear(weighted.points)[:, None] * np.array([1.0, 2.0])
    expected = np.linalg.lstsq(matrix * roots[:, None], samples * roots[:, None], rcond=None)[0]
    assert weighted.coefficients(samples) == pytest.approx(expected, rel=1e-8, abs=1e-10)
    fitted = np.asarray(weighted.matrix) @ np.asarray(weighted.pseudo_inverse)
    assert weighted.leverage == pytest.approx(np.diag(fitted), rel=1e-9)
