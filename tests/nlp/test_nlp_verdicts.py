"""Solved means what was asked for, in the user's units: no scale of a program changes the verdict."""

from dataclasses import replace

import nlp_problems as problems
import numpy as np
import pytest
import scipy.optimize
from nlp_problems import evaluation, program

from aleator.nlp import FilterSQP, Slsqp, Status
from aleator.nlp._matrices import nonnegative_fit


def rescaled(inner, objective=1.0, rows=1.0, decisions=1.0):
    """A program in other units, whose typical magnitudes are known."""

    def evaluate(x):
        found = inner.evaluate(x / decisions)
        return evaluation(
            objective * found.objective,
            objective * found.gradient / decisions,
            rows * found.constraints,
            rows * found.jacobian / decisions,
        )

    return replace(
        inner,
        evaluate=evaluate,
        start=inner.start * decisions,
        lower=inner.lower * decisions,
        upper=inner.upper * decisions,
        constraint_lower=inner.constraint_lower * rows,
        constraint_upper=inner.constraint_upper * rows,
        constraint_scale=inner.constraint_scale * rows,
        variable_scale=inner.variable_scale * decisions,
    )


@pytest.mark.parametrize("part", ["objective", "rows", "decisions"])
@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_units_change_no_verdict(solver, part, factor):
    solved = solver.solve(rescaled(problems.hs71(), **{part: factor}))
    assert solved.ok
    units = factor if part == "decisions" else 1.0
    np.testing.assert_allclose(solved.point / units, [1, 4.7429994, 3.8211503, 1.3794082], rtol=1e-4)
    # HS71 with a product of at least 1000, which numbers up to 5 whose squares sum to 40 do not have.
    broken = solver.solve(rescaled(problems.hs71(product_at_least=1000.0), **{part: factor}))
    # SLSQP ends anywhere, and `al.solve` tells by another search that nothing is feasible.
    assert broken.status is (Status.FAILED if isinstance(solver, Slsqp) else Status.INFEASIBLE)


def wild(scale, size):
    """x = 1 is asked of a row whose scale is given by a wild gradient; its magnitude is `size`."""
    declared = program(
        lambda x: evaluation(x[0] ** 2, 2 * x, [x[0]], [[1.0]]),
        [0.0],
        [-2.0],
        [2.0],
        [(1, 1)],
        constraint_scale=[scale],
    )
    return replace(declared, sizes=lambda x, found: np.array([size]))


@pytest.mark.parametrize("scale", [1e-9, 1e4, 1e14])
def test_feasibility_is_judged_by_the_size_of_a_row_and_not_by_what_solvers_divide_by(solver, scale):
    outcome = solver.solve(wild(scale, 1.0))
    assert outcome.ok
    assert outcome.point == pytest.approx(np.ones(1), abs=1e-6)
    assert outcome.sizes == pytest.approx(np.ones(1))
    assert outcome.multipliers == pytest.approx(np.array([-2.0]), rel=1e-5)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_what_is_called_solved_is_within_the_tolerance_asked_for(solver, tolerance):
    outcome = replace(solver, tolerance=tolerance).solve(problems.hs71())
    residuals = outcome.violation, outcome.stationarity, outcome.complementarity
    assert outcome.ok == (max(residuals) <= tolerance)
    if not outcome.ok:
        assert f"where {tolerance:.0e} is asked" in outcome.message
    assert outcome.ok or tolerance < 1e-6


@pytest.mark.parametrize("solver", [FilterSQP(), Slsqp()], ids=["filterSQP", "SLSQP"])
def test_a_minimum_at_a_kink_is_no_solution_unless_it_is_known_to_be_least(solver):
    def evaluate(x):
        away = np.array([1.0, 3.0]) * (x - 1)
        size = np.linalg.norm(away)
        return evaluation(size, np.array([1.0, 3.0]) * away / size if size else np.zeros(2))

    declared = program(evaluate, [3.0, -1.0], [-5.0, -5.0], [5.0, 5.0])
    outcome = solver.solve(replace(declared, least=0.0))
    assert outcome.ok
    np.testing.assert_allclose(outcome.point, 1.0, atol=1e-5)
    # Where it lies higher than its least value there is a slope, and no kink to excuse it.
    assert not replace(solver, max_iterations=1).solve(replace(declared, least=0.0)).ok


@pytest.mark.parametrize("make", [FilterSQP, Slsqp])
@pytest.mark.parametrize(("curve", "price"), [(0, 2.0), (1, 3.0)])
def test_the_kink_of_a_limit_is_an_optimum_if_its_sides_together_hold_it(make, curve, price):
    outcome = make().solve(problems.folded(curve, [0.9, 0.95]))
    assert outcome.status is Status.SOLVED
    np.testing.assert_allclose(outcome.point, 1.0, atol=1e-6)
    np.testing.assert_allclose(outcome.multipliers, price, rtol=1e-5)


@pytest.mark.parametrize("kind", ["any", "equalities", "dependent", "badly scaled", "exact"])
def test_nonnegative_fits_are_as_close_as_those_of_scipy(kind):
    rng = np.random.default_rng(0)
    for _ in range(100):
        count, size = rng.integers(1, 15), rng.integers(1, 10)
        rows, target = rng.normal(size=(count, size)), rng.normal(size=size)
        match kind:
            case "equalities":  # once with each sign
                rows = np.concatenate([rows, -rows])
            case "dependent":
                rows = np.concatenate([rows, 2 * rows, np.eye(size), np.zeros((1, size))])
            case "badly scaled":
                rows *= 10.0 ** rng.uniform(-6, 2, size=(count, 1))
            case "exact":
                target = rng.uniform(size=count) @ rows
        weights, peers = nonnegative_fit(rows, target), scipy.optimize.nnls(rows.T, target)[0]
        missed, least = (np.linalg.norm(one @ rows - target) for one in (weights, peers))
        assert (weights >= 0).all()
        assert missed <= least + 1e-9 * np.linalg.norm(target)
