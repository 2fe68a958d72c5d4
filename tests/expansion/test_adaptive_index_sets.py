"""Index sets by their definitions, and those that grow: published Sobol indices, closed forms, budgets, bad input."""

import math

import numpy as np
import pytest

import aleator as al
from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator.expansion import (
    Adaptive,
    Expansion,
    HammersleyPoints,
    RandomPoints,
    collocate,
)
from aleator.uncertainty import LegendreGerm


def uniform(variables):
    return {f"x{i + 1}": LegendreGerm() for i in range(variables)}


def expanded(model, germs, expansion):
    basis, collocation = collocate(germs, expansion, model)
    samples = model(np.asarray(collocation.points))
    return basis, collocation, collocation.coefficients(samples), samples


def share(basis, coefficients, *variables):
    """The part of the variance in terms of exactly these variables."""
    inside = np.zeros(basis.variables, dtype=bool)
    inside[list(variables)] = True
    own = np.all((basis.indices > 0) == inside[None, :], axis=1)
    squares = np.asarray(coefficients) ** 2
    return squares[own].sum() / squares[1:].sum()


def ishigami(points):
    x = np.pi * points.T
    return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def test_ishigamis_moments_and_sobol_indices_are_the_published_ones():
    expansion = Expansion(index_set=Adaptive(error=1e-5, budget=1000))
    basis, collocation, coefficients, _ = expanded(ishigami, uniform(3), expansion)
    assert len(collocation.points) < 1000
    assert np.asarray(coefficients)[0] == pytest.approx(3.5, abs=1e-4)
    assert float(np.sum(np.asarray(coefficients)[1:] ** 2)) == pytest.approx(13.8445879407, abs=1e-4)
    assert share(basis, coefficients, 0) == pytest.approx(0.3139051912, abs=1e-5)
    assert share(basis, coefficients, 1) == pytest.approx(0.4424111448, abs=1e-5)
    assert share(basis, coefficients, 0, 2) == pytest.approx(0.2436836641, abs=1e-5)


def test_a_sparse_polynomial_is_found_exactly_with_few_points():
    # order 7 in six variables: 1716 terms of total degree
    def model(xi):
        return 1 + xi[:, 0] ** 7 + xi[:, 1] * xi[:, 2] + 0.5 * xi[:, 3] ** 2 * xi[:, 4] ** 2

    expansion = Expansion(index_set=Adaptive(error=1e-10, budget=400), points=RandomPoints(seed=2))
    basis, collocation, _, samples = expanded(model, uniform(6), expansion)
    rows = {tuple(row) for row in basis.indices.tolist()}
    assert {(7, 0, 0, 0, 0, 0), (0, 1, 1, 0, 0, 0), (0, 0, 0, 2, 2, 0)} <= rows
    assert np.asarray(collocation.matrix) @ np.asarray(collocation.coefficients(samples)) == pytest.approx(samples)
    assert basis.order == 7


def test_sets_are_downward_closed_sorted_and_within_budget_and_order():
    budget = 200
    with pytest.warns(ExpansionWarning, match="limit of its budget"):
        basis, collocation, _, _ = expanded(
            ishigami, uniform(3), Expansion(9, index_set=Adaptive(error=1e-6, budget=budget))
        )
    rows = basis.indices.tolist()
    present = {tuple(row) for row in rows}
    for row in rows:
        for i, degree in enumerate(row):
            assert degree == 0 or (*row[:i], degree - 1, *row[i + 1 :]) in present
    assert basis.order <= 9
    assert len(collocation.points) <= budget
    assert 3 * basis.terms <= len(collocation.points)


def test_an_output_that_is_not_finite_is_named_with_its_point():
    def model(xi):
        return {"force": np.where(np.arange(len(xi)) == 4, np.nan, xi[:, 0])}

    with pytest.raises(
        SimulationError, match=r"not finite at 1 of 9 points: output 'force' first at point 5 \(germ x1=.*, x2="
    ):
        collocate(uniform(2), Expansion(index_set=Adaptive()), model)


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        (lambda: Expansion(index_set=Adaptive(), points=HammersleyPoints()), "HammersleyPoints do not allow"),
        (lambda: Expansion(index_set=Adaptive(), points=200), r"al\.index_sets\.Adaptive\(budget=200\)"),
    ],
)
def test_wishes_that_do_not_go_together_are_refused_with_a_remedy(wish, message):
    with pytest.raises(ProblemError, match=message):
        collocate(uniform(2), wish(), ishigami)


NAMES = tuple("abcdefghijklmnopqrst")
SETS = [
    (al.index_sets.TotalDegree(), lambda rows, order: rows.sum(axis=1) <= order),
    (al.index_sets.TensorProduct(), lambda rows, order: rows.max(axis=1) <= order),
    (al.index_sets.HyperbolicCross(0.5), lambda rows, order: np.sqrt(rows).sum(axis=1) ** 2 <= order + 1e-6),
    (al.index_sets.Anisotropic([1.0, 2.0, 1.5]), lambda rows, order: rows @ [1.0, 2.0, 1.5] <= order + 1e-6),
    (al.index_sets.Anisotropic({"b": 0.7}), lambda rows, order: rows @ [1.0, 0.7, 1.0] <= order + 1e-6),
]


@pytest.mark.parametrize("order", [1, 7])
@pytest.mark.parametrize(("index_set", "keeps"), SETS)
def test_a_set_holds_what_its_definition_keeps_of_all_multi_indices_once_in_order(index_set, keeps, order):
    everything = np.indices((2 * order + 1,) * 3).reshape(3, -1).T
    expected = {tuple(row) for row in everything[keeps(everything, order)].tolist()}
    rows = [tuple(row) for row in index_set.indices(("a", "b", "c"), order).tolist()]
    # Sorted by degree, then by the degrees of the first variables.
    assert rows == sorted(expected, key=lambda row: (sum(row), [-degree for degree in row]))


def test_many_variables_and_high_orders_need_no_enumeration_of_the_full_tensor():
    # 4^20 and 15^8 multi-indices would not fit into any memory
    assert len(al.index_sets.TotalDegree().indices(NAMES, 3)) == math.comb(23, 3)
    cross = al.index_sets.HyperbolicCross(0.5).indices(NAMES[:8], 14)
    assert cross.max(axis=0).tolist() == [14] * 8
    assert (cross > 0).sum(axis=1).max() == 3  # four factors of degree one have the q-norm 16


def test_weights_of_the_wrong_number_and_sets_too_large_for_memory_are_refused():
    with pytest.raises(al.ProblemError, match=r"one weight for each of the 3 germ variables.*received 2"):
        al.index_sets.Anisotropic([1, 2]).indices(NAMES[:3], 2)
    with pytest.raises(al.ProblemError, match=r"more than 200000 terms in 20 variables.*HyperbolicCross"):
        al.index_sets.TensorProduct().indices(NAMES, 3)
