"""Correlations that decided shapes move away from those given: told as they are, and regained by solving again."""

import numpy as np
import pytest

import aleator as al
from zoo import algebraic, optimum

Sum = algebraic(lambda a, b: {"y": a + b})


def problem(first, second, rho=0.6):
    """The cheapest spreads of two numbers whose sum spreads by 1.2."""
    pair = al.correlated({"a": first, "b": second}, {("a", "b"): rho})
    cost = [al.cost.reciprocal(f"{name}.std", bias=0.0, scale=0.1) for name in pair]
    limit = al.output("y").std <= 1.2
    return al.Problem(Sum(**pair), minimize=cost[0] + cost[1], subject_to=[limit], expansion=al.Expansion(order=8))


def lognormals(start):
    return [al.LogNormal(mean=1.0, std=al.Decision(start, 0.02, 3.0)) for _ in range(2)]


def pearson(start, std, rho=0.6):
    """Of two lognormals of mean 1, whose copula gives them the correlation `rho` at another spread."""
    normal = np.log1p(rho * start**2) / np.log1p(start**2)
    return np.expm1(normal * np.log1p(std**2)) / std**2


def test_correlations_that_a_decided_shape_moves_are_told_and_solving_again_regains_them():
    with pytest.warns(al.CorrelationWarning, match="0.554 between a and b in the place of 0.6") as caught:
        solution = al.solve(problem(*lognormals(0.05)))
    assert len(caught) == 1
    assert pearson(0.05, solution.decisions["a.std"]) == pytest.approx(0.554, abs=5e-4)
    again = al.solve(problem(*lognormals(1.2 / np.sqrt(2 * 1.6))))  # where it ends if it is solved again and again
    assert not again.certificate.correlations
    assert again.decisions["a.std"] == pytest.approx(1.2 / np.sqrt(2 * 1.6), rel=2e-3)


def test_scales_leave_correlations_and_the_problem_shows_them():
    normals = [al.Normal(1.0, al.Decision(0.3, 0.02, 3.0)) for _ in range(2)]
    told = problem(*normals)
    assert "correlated  b: 0.6 with a" in str(told)
    assert optimum(told).decisions["a.std"] == pytest.approx(1.2 / np.sqrt(2 * 1.6), rel=1e-6)
