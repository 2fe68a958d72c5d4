"""Full and sparse grids of Gauss points: exactness on monomials, chaospy's rules, and projection by them."""

import math

import chaospy
import numpy as np
import pytest

import aleator as al
from aleator.expansion import Basis, collocate
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm

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


def test_a_sparse_grid_shares_its_points_and_has_far_fewer_than_the_full_one():
    germs = {name: HermiteGerm() for name in "abcde"}
    basis = Basis(germs, al.index_sets.TotalDegree().indices(tuple(germs), 3))
    nodes = al.points.SmolyakPoints().nodes(basis, 0)
    assert len(np.unique(nodes.points, axis=0)) == len(nodes.points) < 4**5 / 4
    assert (nodes.weights < 0).any()
    assert nodes.weights.sum() == pytest.approx(1, rel=1e-12)


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


def test_interpolation_on_a_full_grid_is_the_projection():
    parts = [
        collocate(
            {"u": LegendreGerm(), "n": HermiteGerm()},
            al.Expansion(3, index_set=al.index_sets.TensorProduct(), points=p, fit=fit),
        )
        for p, fit in (
            (al.points.GaussPoints(), al.fits.Interpolation()),
            (al.points.GaussPoints(), al.fits.Projection()),
        )
    ]
    interpolated, projected = (np.asarray(one.collocation.pseudo_inverse) for one in parts)
    assert interpolated == pytest.approx(projected, abs=1e-10)
