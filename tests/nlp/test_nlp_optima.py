import nlp_problems as problems
import numpy as np
import pytest

from aleator.nlp import FilterSQP, InteriorPoint

PUBLISHED = {
    "rosenbrock": (problems.rosenbrock, 0.0, [1, 1]),
    "hs15": (problems.hs15, 306.5, [0.5, 2]),
    "hs28": (problems.hs28, 0.0, [0.5, -0.5, 0.5]),
    "hs35": (problems.hs35, 1 / 9, [4 / 3, 7 / 9, 4 / 9]),
    "hs71": (problems.hs71, 17.0140173, [1, 4.7429994, 3.8211503, 1.3794082]),
    "disc": (problems.disc, 2 * (2 - np.sqrt(0.5)) ** 2, [np.sqrt(0.5)] * 2),
    "coope_watson": (problems.coope_watson, -3 / 16 + (3 - np.sqrt(5)) / 2, [-0.75, (1 - np.sqrt(5)) / 2]),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_every_solver_finds_the_published_optimum_with_multipliers_of_its_bounds_in_user_units(solver, name):
    make, objective, decisions = PUBLISHED[name]
    program = make()
    outcome = solver.solve(program)
    assert outcome.ok, outcome
    found = outcome.evaluation
    assert found.objective == pytest.approx(objective, rel=1e-6, abs=1e-6)
    assert outcome.point == pytest.approx(np.array(decisions), rel=1e-4, abs=1e-4)
    # Uno's interior points relax bounds a little.
    assert outcome.violation <= (1e-6 if isinstance(solver, InteriorPoint) else 1e-7)
    assert max(outcome.stationarity, outcome.complementarity) <= 1e-5
    # The Lagrangian is stationary, relative to the scale of the objective and the largest multiplier.
    gradient = found.gradient + outcome.multipliers @ found.jacobian + outcome.bound_multipliers
    size = max(1, np.abs(outcome.multipliers).max(initial=0), np.abs(program.evaluate(program.start).objective))
    assert np.abs(gradient).max() <= 2e-5 * size
    assert (outcome.multipliers[np.isinf(program.constraint_upper)] <= 1e-5 * size).all()
    assert (outcome.multipliers[np.isinf(program.constraint_lower)] >= -1e-5 * size).all()


@pytest.mark.parametrize(("changed", "bound", "index"), [("product_at_least", 25.0, 0), ("squares", 40.0, 1)])
def test_a_multiplier_is_the_sensitivity_of_the_optimum_to_its_bound(solver, changed, bound, index):
    shift = 1e-3
    multiplier = solver.solve(problems.hs71()).multipliers[index]
    ends = [solver.solve(problems.hs71(**{changed: bound + sign * shift})).evaluation.objective for sign in (1, -1)]
    assert (ends[0] - ends[1]) / (2 * shift) == pytest.approx(-multiplier, rel=2e-3)


def test_a_warm_start_costs_fewer_points_than_a_cold_one(solver):
    if isinstance(solver, InteriorPoint):
        pytest.skip("Uno's interior points begin far from all bounds, however close they are")
    cold = solver.solve(problems.coope_watson())
    warm = solver.solve(problems.coope_watson(), start=cold.point, multipliers=cold.multipliers)
    assert warm.ok
    assert warm.evaluations < cold.evaluations
    assert warm.point == pytest.approx(cold.point, abs=1e-5)


def test_filter_sqp_needs_few_points_where_thousands_of_rows_are_nearly_active():
    pytest.importorskip("unopy")
    assert FilterSQP().solve(problems.disc()).evaluations <= 8
