"""Sparse expansions: published Sobol indices, sparse polynomials, a search through all columns."""

import numpy as np
import pytest

import aleator as al
from aleator.expansion import collocate, leave_one_out
from aleator.expansion._fit import sparse_terms
from aleator.uncertainty import HermiteGerm, LegendreGerm

SOBOL_G = np.array([0, 1, 4.5, 9, 99, 99, 99, 99])


def uniform(variables):
    return {f"x{i + 1}": LegendreGerm() for i in range(variables)}


def sobol_g(points):
    return np.prod((np.abs(2 * points) + SOBOL_G) / (1 + SOBOL_G), axis=1)


def first_order(basis, coefficients):
    squares = np.asarray(coefficients) ** 2
    alone = (basis.indices > 0).sum(axis=1) == 1
    own = [squares[alone & (basis.indices[:, i] > 0)].sum() for i in range(basis.variables)]
    return np.array(own) / squares[1:].sum()


def test_sobols_g_function_has_its_indices_by_the_sparse_route():
    expansion = al.Expansion(
        10, index_set=al.index_sets.HyperbolicCross(0.6), points=al.points.SobolPoints(400), fit=al.fits.Sparse()
    )
    basis, collocation = collocate(uniform(8), expansion, sobol_g)
    coefficients = collocation.coefficients(sobol_g(np.asarray(collocation.points)))
    partial = 1 / (3 * (1 + SOBOL_G) ** 2)
    exact = partial / (np.prod(1 + partial) - 1)
    assert exact[0] == pytest.approx(0.716, abs=5e-4)
    assert first_order(basis, coefficients) == pytest.approx(exact, abs=0.02)


@pytest.mark.parametrize("points", [al.points.SobolPoints(90), al.points.ChristoffelPoints(90)])
def test_a_sparse_polynomial_among_hundreds_of_candidates_is_found_with_fewer_points_than_candidates(points):
    chosen = {(0,) * 10, (1, 0, 0, 0, 0, 0, 0, 0, 0, 0), (0, 0, 2, 0, 0, 0, 0, 0, 0, 1), (0, 1, 0, 0, 1, 0, 0, 0, 0, 0)}
    germs = uniform(9) | {"n": HermiteGerm()}

    def model(xi):
        return 1 + xi[:, 0] + (3 * xi[:, 2] ** 2 - 1) * xi[:, 9] + xi[:, 1] * xi[:, 4]

    basis, collocation = collocate(germs, al.Expansion(3, points=points, fit=al.fits.Sparse()), model)
    coefficients = collocation.coefficients(model(np.asarray(collocation.points)))
    large = basis.indices[np.abs(np.asarray(coefficients)) > 1e-9]
    assert {tuple(row) for row in large.tolist()} == chosen
    assert len(al.index_sets.TotalDegree().indices(basis.names, 3)) == 286
    assert basis.terms <= 45


def test_each_term_leaves_the_least_residual_squares_as_long_as_one_stands_out():
    rng = np.random.default_rng(5)
    matrix = np.column_stack([np.ones(60), rng.normal(size=(60, 90)), np.zeros(60)])
    weights = np.where(rng.random((91, 2)) < 0.15, 0.8 ** rng.permutation(182).reshape(91, 2), 0.0)
    outputs = matrix[:, :91] @ weights + rng.normal(size=(60, 2)) / 100

    def left(columns):
        return np.sum((outputs - matrix[:, columns] @ np.linalg.lstsq(matrix[:, columns], outputs)[0]) ** 2)

    terms = sparse_terms(matrix, [outputs])
    for k, term in enumerate(terms[1:], 1):
        assert left(terms[: k + 1]) <= min(left([*terms[:k], other]) for other in range(91)) * (1 + 1e-9), term
    assert 4 <= len(terms) < 30
    # Of noise next to nothing is taken, but for what another output needs, however small it is there.
    beside = [rng.normal(size=(60, 1)), matrix[:, [7]] + 1e-6 * matrix[:, [20]]]
    taken = sparse_terms(matrix, beside)
    assert {0, 7, 20} <= set(taken)
    assert len(taken) <= 6


def test_all_entries_of_a_path_and_all_outputs_share_one_choice_that_resolves_each():
    times = np.linspace(0.1, 2.0, 40)

    def model(xi):
        path = np.exp(-times[None, :] * (1 + 0.3 * xi[:, :1])) * (1 + 0.2 * xi[:, 1:2])
        return {"path": path, "tiny": 1e-9 * xi[:, 5] ** 3, "constant": np.full(len(xi), 2.0)}

    basis, collocation = collocate(
        uniform(8), al.Expansion(4, points=al.points.SobolPoints(150), fit=al.fits.Sparse()), model
    )
    assert basis.terms < 75 < len(al.index_sets.TotalDegree().indices(basis.names, 4)) == 495
    for values in model(np.asarray(collocation.points)).values():
        assert float(leave_one_out(collocation, values, collocation.coefficients(values))) < 1e-3
