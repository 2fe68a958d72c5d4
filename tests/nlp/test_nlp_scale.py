"""What is called solved depends neither on the units of the objective nor on how steep it is at the start."""

import numpy as np
import pytest
from nlp_problems import INF, evaluation, program

from aleator.nlp import FilterSQP, Ipopt, Slsqp, Status


def parabola(offset):
    return program(lambda x: evaluation((x[0] - 3) ** 2 + offset, 2 * (x - 3)), [1.0], [0.0], [10.0])


@pytest.mark.parametrize("offset", [1e6, -1e8])
def test_an_offset_of_the_objective_moves_no_optimum(solver, offset):
    outcome = solver.solve(parabola(offset=offset))
    assert outcome.ok
    assert outcome.failed_at is None
    assert outcome.point == pytest.approx(np.array([3.0]), abs=1e-5)
    assert outcome.evaluations <= 10 or abs(offset) > 1e6


def test_an_offset_moves_no_multiplier(solver):
    # min (x - 3)² with x <= 1: the multiplier is 4.
    def evaluate(x):
        return evaluation((x[0] - 3) ** 2 + 1e8, 2 * (x - 3), [x[0]], [[1.0]])

    outcome = solver.solve(program(evaluate, [0.0], [-9.0], [9.0], rows=[(-INF, 1)]))
    assert outcome.ok
    assert outcome.multipliers == pytest.approx(np.array([4.0]), abs=1e-3)


def test_rounding_of_the_gradient_is_no_obstacle(solver):
    # The remainder at the optimum is 1e-10 of the slope at the start and changes from point to point.
    def evaluate(x):
        noise = 1e-10 * np.sin(1e9 * x[0])
        return evaluation((x[0] - 3) ** 2 + 1e3, [2 * (x[0] - 3) + noise])

    outcome = solver.solve(program(evaluate, [3.0 + 1e-3], [0.0], [10.0]))
    assert outcome.ok
    assert outcome.point == pytest.approx(np.array([3.0]), abs=1e-5)


def steep(start, typical):
    """1/a² + a falls from up to 1e10 to its minimum 2^(1/3) + 2^(-2/3) at a = 2^(1/3)."""
    return program(
        lambda x: evaluation(x[0] ** -2 + x[0], 1 - 2 * x**-3), [start], [1e-6], [10.0], variable_scale=[typical]
    )


@pytest.mark.parametrize("start", [1e-1, 1e-5])
@pytest.mark.parametrize("from_typical_start", [False, True])
def test_a_steep_start_is_left_behind_or_the_solver_says_that_it_gave_up(solver, start, from_typical_start):
    outcome = solver.solve(steep(start, start if from_typical_start else 1.0))
    assert outcome.status in (Status.SOLVED, Status.ITERATION_LIMIT, Status.FAILED)
    if outcome.ok or (isinstance(solver, FilterSQP) and start >= 1e-3):
        assert outcome.evaluation.objective == pytest.approx(1.8898815748, rel=1e-7)


@pytest.mark.parametrize("make", [FilterSQP, Ipopt, Slsqp])
def test_iterations_are_counted_over_all_restarts_and_their_limit_is_no_solution(make):
    iterations = 6
    outcome = make(max_iterations=iterations).solve(steep(1e-2, 1e-2))
    assert outcome.status is Status.ITERATION_LIMIT
    assert outcome.iterations <= iterations + 1


def walled(x):
    return evaluation(x[0] if x[0] >= 1 else np.nan, [1.0], [x[0]], [[1.0]])


@pytest.mark.slow
def test_a_region_that_cannot_be_evaluated_and_hides_the_optimum_is_named(solver):
    outcome = solver.solve(program(walled, [2.0], [-INF], [10.0], rows=[(-INF, 20)]))
    assert outcome.status is Status.EVALUATION_FAILED
    assert outcome.point[0] >= 1
    assert np.isfinite(outcome.evaluation.objective)
    assert outcome.failed_at is not None
    assert outcome.failed_at[0] < 1
    assert "not finite" in outcome.message


def test_the_start_is_the_failed_point_where_it_cannot_be_evaluated(solver):
    outcome = solver.solve(program(walled, [0.5], [0.0], [10.0], rows=[(-INF, 20)]))
    assert outcome.status is Status.EVALUATION_FAILED
    assert outcome.failed_at == pytest.approx(np.array([0.5]))
    assert outcome.evaluations == 1
    assert np.isnan(outcome.evaluation.objective)


def test_bounds_and_rows_that_hold_the_optimum_are_active(solver):
    # min a + (b - 2)² + c² with a >= 0, b <= 1 by a row, c free and d fixed.
    def evaluate(x):
        return evaluation(
            x[0] + (x[1] - 2) ** 2 + x[2] ** 2 + x[3],
            [1, 2 * (x[1] - 2), 2 * x[2], 1],
            [x[1], x[2], x[2] - x[3]],
            [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, -1]],
        )

    outcome = solver.solve(
        program(
            evaluate,
            [2.0, 0.0, 1.0, 1.0],
            [0, -5, -5, 1],
            [9, 5, 5, 1],
            rows=[(-INF, 1), (-4, 4), (-INF, INF)],
        )
    )
    assert outcome.ok
    assert outcome.active.tolist() == [True, False, False]
    assert outcome.active_bounds.tolist() == [True, False, False, True]
