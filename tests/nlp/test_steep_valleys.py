"""Minima on the floor of steep valleys, as large penalties make them: closed forms, with all solvers."""

import numpy as np
import pytest
from nlp_problems import evaluation, program

# Points of control at which a trajectory has the end position 1 and the end velocity 0, by large penalties.
ROWS = np.array([[0.35, 0.25, 0.2, 0.15, 0.1, 0.05], [0.1, 0.2, 0.2, 0.2, 0.2, 0.1]])
ENDS, OFFSET = np.array([1.0, 0.0]), 3.0


def penalised(weight, lower=None, upper=None):
    """Least sum of squares, with two linear equations as penalties; and its minimum by the normal equations."""

    def evaluate(x):
        missed = ROWS @ x - ENDS
        return evaluation(OFFSET + x @ x + weight * missed @ missed, 2 * x + 2 * weight * ROWS.T @ missed)

    # By Woodbury's identity, because the normal equations themselves lose as many digits as the weight has.
    exact = ROWS.T @ np.linalg.solve(np.eye(2) / weight + ROWS @ ROWS.T, ENDS)
    return program(evaluate, np.ones(6), lower, upper), exact


@pytest.mark.parametrize("weight", [1e4, 1e12])
def test_large_penalties_do_not_hide_the_minimum(solver, weight):
    given, exact = penalised(weight)
    outcome = solver.solve(given)
    assert outcome.ok
    missed = ROWS @ exact - ENDS
    assert outcome.evaluation.objective == pytest.approx(OFFSET + exact @ exact + weight * missed @ missed, rel=1e-4)
    assert outcome.point == pytest.approx(exact, abs=0.03)


def test_a_decision_at_its_bound_stays_there(solver):
    given, free = penalised(1e9)
    lowest = float(free.min()) + 0.5
    given, _ = penalised(1e9, lower=np.full(6, lowest), upper=np.full(6, 20.0))
    outcome = solver.solve(given)
    assert outcome.point.min() >= lowest
    if outcome.ok:
        # No feasible direction lowers the objective noticeably.
        rng = np.random.default_rng(0)
        null = np.linalg.svd(ROWS)[2][2:]
        for direction in rng.normal(size=(200, 4)) @ null:
            moved = np.clip(outcome.point + 1e-3 * direction, lowest, 20.0)
            assert given.evaluate(moved).objective > outcome.evaluation.objective * (1 - 1e-3)


@pytest.mark.parametrize("weight", [1e4, 1e8])
def test_a_curved_valley_is_followed_to_its_end_or_told(solver, weight):
    def evaluate(x):
        off = x[1] - x[0] ** 2
        slope = [-2 * (1 - x[0]) - 4 * weight * off * x[0], 2 * weight * off]
        return evaluation(OFFSET + (1 - x[0]) ** 2 + weight * off**2, slope)

    outcome = solver.solve(program(evaluate, [0.5, 1.0]))
    is_minimum = outcome.evaluation.objective == pytest.approx(OFFSET, rel=1.5e-3)
    assert is_minimum or (not outcome.ok and "floor of a steep valley" in outcome.message), outcome
    assert is_minimum or weight > 1e4


def test_a_minimum_of_zero_is_not_probed_for_ever(solver):
    # Two variables of which only the sum matters: beside rounding there is nothing to gain.
    outcome = solver.solve(
        program(lambda x: evaluation((x[0] + x[1] - 1) ** 2, 2 * (x[0] + x[1] - 1) * np.ones(2)), [3.0, 0.0])
    )
    assert outcome.ok
    assert outcome.evaluation.objective < 1e-9
