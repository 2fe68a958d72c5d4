"""Index sets that grow: published Sobol indices, sets known in closed form, budgets and bad input."""

import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core.errors import ExpansionWarning, ProblemError, SimulationError
from aleator.expansion import (
    Adaptive,
    Expansion,
    HammersleyPoints,
    RandomPoints,
    collocate,
    leave_one_out,
)
from aleator.uncertainty import LegendreGerm


def uniform(variables):
    return {f"x{i + 1}": LegendreGerm() for i in range(variables)}


def expanded(model, germs, expansion):
    basis, collocation = collocate(germs, expansion, model)
    samples = jnp.asarray(model(np.asarray(collocation.points)))
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
    assert float(coefficients[0]) == pytest.approx(3.5, abs=1e-4)
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


def test_no_point_is_solved_twice_and_none_is_lost():
    asked = []

    def model(points):
        asked.append(points)
        return ishigami(points)

    _, collocation = collocate(uniform(3), Expansion(index_set=Adaptive(error=1e-3)), model)
    assert len(asked) > 2
    assert np.array_equal(np.concatenate(asked), collocation.points)


@pytest.mark.slow
def test_the_error_asked_for_is_the_leave_one_out_error_of_every_output():
    def model(xi):
        return {"small": 1e-6 * np.exp(2 * xi[:, 0]), "path": np.sin(np.outer(1 + xi[:, 1], np.arange(1, 6)))}

    _, collocation = collocate(uniform(2), Expansion(index_set=Adaptive(error=3e-4)), model)
    for values in model(np.asarray(collocation.points)).values():
        samples = jnp.asarray(values)
        assert float(leave_one_out(collocation, samples, collocation.coefficients(samples))) <= 3e-4


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
