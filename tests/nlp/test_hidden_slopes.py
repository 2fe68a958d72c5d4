"""Linear programs, and objectives of which one term hides the others: closed forms, and SciPy's HiGHS."""

import numpy as np
import pytest
import scipy.optimize
from nlp_problems import INF, evaluation, program

from aleator.nlp import FilterSQP
from zoo import cases

SEEDS = cases(range(3))


def linear(cost, matrix, most, start, lower, upper):
    """Minimise `cost x` subject to `matrix x <= most` between bounds, with the typical magnitudes of decisions."""
    cost, matrix, start = np.array(cost), np.reshape(matrix, (-1, len(cost))), np.array(start)
    span = np.array(upper) - np.array(lower)
    scale = np.maximum(np.abs(start), np.where(np.isfinite(span), span / 10, 0.0))
    return program(
        lambda x: evaluation(float(cost @ x), cost, matrix @ x, matrix),
        start,
        lower,
        upper,
        [(-INF, float(one)) for one in most],
        scale,
    )


def random_linear(seed):
    """Ranges over seven orders of magnitude, costs over four; feasible by construction, since some point is inside."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 7)), int(rng.integers(0, 5))
    span = 10.0 ** rng.uniform(-3, 4, n)
    lower = rng.uniform(-1, 0, n) * span
    cost = rng.normal(size=n) * 10.0 ** rng.uniform(-2, 2, n) / span
    matrix = rng.normal(size=(m, n)) / span
    most = matrix @ rng.uniform(lower, lower + span) + rng.uniform(0, 0.5, m)
    return linear(cost, matrix, most, rng.uniform(lower, lower + span), lower, lower + span), (cost, matrix, most)


@pytest.mark.parametrize("seed", SEEDS)
def test_linear_programs_of_any_scales_end_at_the_optimum_of_highs(solver, seed):
    given, (cost, matrix, most) = random_linear(seed)
    exact = scipy.optimize.linprog(cost, matrix, most, bounds=np.column_stack([given.lower, given.upper]))
    outcome = solver.solve(given)
    assert outcome.ok
    most_change = float(np.abs(cost) @ (given.upper - given.lower))
    assert outcome.evaluation.objective == pytest.approx(exact.fun, abs=1e-5 * most_change)


def test_a_level_rises_as_far_as_it_must():
    offset = 1e4
    # The least level above two rows that are far above its start: -4 + offset.
    rows = [[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]]
    given = linear([0.0, 0.0, 1.0], rows, [-offset, -offset], [0.5, 0.5, 1.0], [-4.0, -4.0, 0.0], [4.0, 4.0, INF])
    outcome = FilterSQP().solve(given)
    assert outcome.ok
    assert outcome.point == pytest.approx([-4.0, -4.0, offset - 4.0], rel=1e-6)


def test_more_linear_decisions_than_differences_are_taken_for(solver):
    rng = np.random.default_rng(0)
    cost, upper = rng.uniform(0.1, 1.0, 40), 10.0 ** rng.uniform(-2, 3, 40)
    cost *= rng.choice([-1.0, 1.0], 40) / upper
    outcome = solver.solve(linear(cost, [], [], upper / 2, np.zeros(40), upper))
    assert outcome.ok
    assert outcome.evaluation.objective == pytest.approx(float(np.minimum(cost * upper, 0.0).sum()), rel=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_term_of_a_sum_hides_the_others(solver, seed):
    # Terms over twelve orders of magnitude, linear ones and squares, each in a variable of its own.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    weights, centres, is_linear = 10.0 ** rng.uniform(-4, 8, n), rng.uniform(-3, 3, n), rng.random(n) < 0.5

    def evaluate(x):
        terms = np.where(is_linear, weights * (x + 4), weights * (x - centres) ** 2)
        return evaluation(float(terms.sum()), np.where(is_linear, weights, 2 * weights * (x - centres)))

    given = program(evaluate, np.zeros(n), np.full(n, -4.0), np.full(n, 4.0), variable_scale=np.full(n, 0.8))
    outcome = solver.solve(given)
    # The least value is zero: what is left is nothing beside the start, and may hide what no double shows.
    assert outcome.ok
    assert outcome.evaluation.objective <= 1e-6 * evaluate(np.zeros(n)).objective


@pytest.mark.parametrize("weight", [1e2, 1e8])
def test_a_priced_excess_hides_no_other_decision(solver, weight):
    # An exact penalty of the limit x <= 1 by an excess t: the optimum is 4 at (1, 1, 0).
    def evaluate(x):
        value = (x[0] - 3) ** 2 + (x[1] - 1) ** 2 + weight * x[2]
        return evaluation(value, [2 * (x[0] - 3), 2 * (x[1] - 1), weight], [x[0] - x[2]], [[1.0, 0.0, -1.0]])

    given = program(
        evaluate, [0.5, 0.5, 0.0], [-4.0, -4.0, 0.0], [4.0, 4.0, INF], [(-INF, 1.0)], np.array([0.8, 0.8, 1.0])
    )
    outcome = solver.solve(given)
    # Interior points end 1e-9 from bounds, which has its own price.
    assert not outcome.ok or outcome.point == pytest.approx([1.0, 1.0, 0.0], abs=1e-3)
    if isinstance(solver, FilterSQP):
        assert outcome.ok
        assert outcome.evaluation.objective == pytest.approx(4.0, rel=1e-6)
