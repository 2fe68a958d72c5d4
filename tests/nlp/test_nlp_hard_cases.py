"""What makes programs hard: no solution, regions without values, interruptions, offsets and steep starts."""

import signal
import sys

import nlp_problems as problems
import numpy as np
import pytest
from nlp_problems import INF, evaluation, program

from aleator._core.errors import MissingExtraError, ProblemError
from aleator.nlp import FilterSQP, Ipopt, Status, default_solver


def test_a_program_without_solution_is_infeasible_at_the_least_violated_point(solver):
    # The row x² + y² + 1 <= 0 is violated by at least 1, at the origin.
    outcome = solver.solve(
        program(lambda x: evaluation(x[0] - x[1], [1, -1], [x @ x + 1], [2 * x]), [2.0, -1.0], rows=[(-INF, 0)])
    )
    assert outcome.status is Status.INFEASIBLE
    assert not outcome.ok
    assert outcome.violation == pytest.approx(1.0, abs=1e-4)


def test_a_region_that_cannot_be_evaluated_is_backed_off_from(solver):
    # Steps from 0.1 overshoot far into x < 0, where the logarithm is not a number; the optimum is x = 1/2.
    def evaluate(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return evaluation(2 * x[0] - np.log(x[0]), 2 - 1 / x, [x[0]], [[1]])

    outcome = solver.solve(program(evaluate, [5.0], rows=[(-INF, 50)]))
    assert outcome.ok
    assert outcome.point == pytest.approx(np.array([0.5]), abs=1e-4)


def test_an_objective_without_minimum_is_not_called_solved(solver):
    outcome = solver.solve(program(lambda x: evaluation(x[0], [1.0]), [0.0]))
    assert outcome.status in (Status.ITERATION_LIMIT, Status.FAILED)


def test_more_equalities_than_decisions_are_no_obstacle_where_they_agree(solver, capfd):
    outcome = solver.solve(
        program(lambda x: evaluation(x[0], [1.0], [x[0], 2 * x[0]], [[1], [2]]), [3.0], rows=[(1, 1), (2, 2)])
    )
    assert outcome.ok
    assert outcome.point == pytest.approx(np.array([1.0]), abs=1e-6)
    assert capfd.readouterr() == ("", "")


def after(calls, action, make=problems.hs71):
    """The program, with `action` instead of the value once `calls` points have been evaluated."""
    made, count = make(), 0
    inner = made.evaluate

    def evaluate(x):
        nonlocal count
        count += 1
        if count > calls:
            action()
        return inner(x)

    object.__setattr__(made, "evaluate", evaluate)
    return made


def interrupt():
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("calls", "action"), [(0, interrupt), (3, lambda: signal.raise_signal(signal.SIGINT))], ids=["raised", "signal"]
)
@pytest.mark.usefixtures("python_interrupts")
def test_an_interrupt_ends_the_solve_with_the_best_point_so_far(solver, calls, action):
    before = signal.getsignal(signal.SIGINT)
    outcome = solver.solve(after(calls, action))
    assert outcome.status is Status.INTERRUPTED
    assert outcome.evaluations == calls + 1
    assert np.isfinite(outcome.point).all()
    assert np.isfinite(outcome.violation) == (calls > 0)
    assert signal.getsignal(signal.SIGINT) is before


def test_an_exception_of_the_model_reaches_the_caller_unchanged(solver):
    error = LookupError("no such material")

    def fail():
        raise error

    with pytest.raises(LookupError) as caught:
        solver.solve(after(3, fail))
    assert caught.value is error


def test_a_fixed_decision_stays_and_its_multiplier_is_its_sensitivity(solver):
    # min (x-2)² + (y-1)² + x y with x = 1/2: y = 3/4; d f*/d x = 2(x-2) + y = -9/4.
    def evaluate(x):
        return evaluation(
            (x[0] - 2) ** 2 + (x[1] - 1) ** 2 + x[0] * x[1], [2 * (x[0] - 2) + x[1], 2 * (x[1] - 1) + x[0]]
        )

    outcome = solver.solve(program(evaluate, [3.0, 0.0], lower=[0.5, -INF], upper=[0.5, INF]))
    assert outcome.ok
    assert outcome.point == pytest.approx(np.array([0.5, 0.75]), abs=1e-6)
    assert outcome.bound_multipliers == pytest.approx(np.array([2.25, 0]), abs=1e-5)


def test_a_start_outside_the_bounds_is_moved_to_them_and_no_point_leaves_them(solver):
    seen = []

    def evaluate(x):
        seen.append(x[0])
        return evaluation(np.sqrt(x[0]) + x[0], [0.5 / np.sqrt(x[0]) + 1])

    outcome = solver.solve(program(evaluate, [9.0], [0.25], [4.0]))
    assert outcome.ok
    assert outcome.point == pytest.approx(np.array([0.25]), abs=1e-6)
    assert min(seen) >= 0.25
    assert max(seen) <= 4.0


def test_without_unopy_filter_sqp_names_the_remedy_and_ipopt_is_the_default(monkeypatch):
    monkeypatch.setitem(sys.modules, "unopy", None)
    with pytest.raises(MissingExtraError, match=r"pip install unopy.*Ipopt\(\)"):
        FilterSQP().solve(problems.hs15())
    assert default_solver() == Ipopt()


def test_crossed_bounds_and_derivatives_of_the_wrong_shape_are_refused(solver):
    with pytest.raises(ProblemError, match=r"Expected `lower` <= `upper`. Received 1.0 and 0.0 at index 0"):
        program(problems.rosenbrock().evaluate, [0.0, 0.0], [1.0, 0.0], [0.0, 1.0])
    with pytest.raises(ProblemError, match="Expected gradient, constraints and jacobian of shapes"):
        solver.solve(program(lambda x: evaluation(0.0, [0.0, 0.0, 0.0]), [0.0, 0.0]))


# --- Offsets, steep starts, and regions without values ---------------------------------------------------------------


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


def walled(x):
    return evaluation(x[0] if x[0] >= 1 else np.nan, [1.0], [x[0]], [[1.0]])


def test_the_start_is_the_failed_point_where_it_cannot_be_evaluated(solver):
    outcome = solver.solve(program(walled, [0.5], [0.0], [10.0], rows=[(-INF, 20)]))
    assert outcome.status is Status.EVALUATION_FAILED
    assert outcome.failed_at == pytest.approx(np.array([0.5]))
    assert outcome.evaluations == 1
    assert np.isnan(outcome.evaluation.objective)
