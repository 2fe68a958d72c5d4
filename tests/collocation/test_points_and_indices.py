"""Index sets and point sets against closed forms, chaospy and scipy's low-discrepancy sequences."""

import math

import chaospy
import numpy as np
import pytest
from scipy.stats import qmc

from aleator.collocation import hammersley, total_degree

SIZES = [(1, 1), (1, 6), (2, 3), (3, 4), (5, 2), (5, 3), (8, 2)]


@pytest.mark.parametrize(("variables", "order"), SIZES)
def test_the_number_of_terms_is_the_binomial_coefficient(variables, order):
    n_b = math.factorial(variables + order) // (math.factorial(variables) * math.factorial(order))
    assert total_degree(variables, order).shape == (n_b, variables)


@pytest.mark.parametrize(("variables", "order"), SIZES)
def test_the_terms_are_all_products_up_to_the_total_degree_each_once(variables, order):
    everything = np.indices((order + 1,) * variables).reshape(variables, -1).T
    expected = {tuple(row) for row in everything.tolist() if sum(row) <= order}
    rows = [tuple(row) for row in total_degree(variables, order).tolist()]
    assert set(rows) == expected
    assert len(rows) == len(expected)


@pytest.mark.parametrize(("variables", "order"), SIZES)
def test_the_terms_are_those_of_chaospy(variables, order):
    theirs = chaospy.monomial(0, order + 1, dimensions=variables).exponents if variables > 1 else None
    if theirs is None:
        theirs = np.arange(order + 1)[:, None]
    assert {tuple(row) for row in total_degree(variables, order).tolist()} == {tuple(row) for row in theirs.tolist()}


@pytest.mark.parametrize(("variables", "order"), SIZES)
def test_the_terms_are_sorted_by_degree_and_start_with_the_constant(variables, order):
    degrees = total_degree(variables, order).sum(axis=1)
    assert degrees[0] == 0
    assert np.all(np.diff(degrees) >= 0)


def test_without_variables_there_is_only_the_constant():
    assert total_degree(0, 3).shape == (1, 0)


def test_the_hammersley_set_has_halton_columns_beside_an_even_one():
    variables, count = 6, 50
    halton = qmc.Halton(d=variables - 1, scramble=False).random(count + 1)[1:]
    points = hammersley(count, variables)
    assert points[:, 0] == pytest.approx((np.arange(count) + 0.5) / count, rel=1e-15)
    assert points[:, 1:] == pytest.approx(halton, rel=1e-13)


def test_radical_inverses_mirror_the_digits():
    # 1 .. 6 in base 2: 1, 10, 11, 100, 101, 110; in base 3: 1, 2, 10, 11, 12, 20
    points = hammersley(6, 3)
    assert points[:, 1].tolist() == [1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8]
    assert points[:, 2] == pytest.approx([1 / 3, 2 / 3, 1 / 9, 4 / 9, 7 / 9, 2 / 9], rel=1e-15)


@pytest.mark.parametrize("variables", [1, 2, 5, 12])
@pytest.mark.parametrize("count", [1, 2, 64, 243, 1000])
def test_all_points_lie_strictly_inside_the_unit_cube(count, variables):
    points = hammersley(count, variables)
    assert points.shape == (count, variables)
    assert np.all((points > 0) & (points < 1))


def test_no_point_comes_twice():
    points = hammersley(500, 4)
    for column in points.T:
        assert len(np.unique(column)) == 500


def test_the_hammersley_set_is_more_even_than_random_points():
    random = np.random.default_rng(0).random((256, 3))
    assert qmc.discrepancy(hammersley(256, 3)) < 0.2 * qmc.discrepancy(random)


def test_without_variables_there_is_one_empty_point():
    assert hammersley(1, 0).shape == (1, 0)
