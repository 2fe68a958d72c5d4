"""Fronts along a bound against their closed forms, what becomes of points without a design, and evidence along them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import aleator as al
from aleator.sweep import _runner
from zoo import MASS, SPREAD, STRESS, Bar, bar_problem

NEEDED = 1.0 + 3.0 * SPREAD


def test_a_front_is_that_of_single_solves_and_of_the_closed_form():
    # The bar is at least 0.1 wide: weaker limits than that are idle; and at most 10 wide.
    bounds = np.array([0.3, 0.14, 1.0, 20.0])
    front = al.pareto(bar_problem(), "stress", bounds)
    solved = np.array([True, False, True, True])
    np.testing.assert_array_equal(front.solved, solved)
    assert not front.interrupted
    np.testing.assert_array_equal(front.values, bounds)
    assert front.objectives[2] == al.solve(bar_problem(stress=1.0)).objective
    np.testing.assert_allclose(front.objectives[solved], np.maximum(NEEDED / bounds, 0.1)[solved], rtol=1e-6)
    prices = np.where(bounds < 10, NEEDED / bounds**2, 0.0)
    np.testing.assert_allclose(front.shadow_prices[solved], prices[solved], rtol=1e-5, atol=1e-6)
    assert front.neighbours == (None,) * len(bounds)
    # The point without a design is kept with its least violation.
    assert front.solutions[1].status is al.Status.INFEASIBLE
    assert front.solutions[1].constraints[0].violation == pytest.approx(NEEDED / 10 - 0.14, rel=1e-5)
    assert np.isnan([front.objectives[1], front.shadow_prices[1]]).all()
    assert front.violations[1] > 0.01
    assert "'stress' is violated by" in str(front)


def test_ctrl_c_ends_a_front_with_the_points_that_are_finished_and_is_itself_where_there_are_none(monkeypatch):
    begun, allowed = [], 2

    def solve(*arguments, **options):
        begun.append(arguments)
        if len(begun) > allowed:
            raise KeyboardInterrupt
        return al.solve(*arguments, **options)

    monkeypatch.setattr(_runner, "solve", solve)
    front = al.pareto(bar_problem(), "stress", [0.5, 0.4, 0.3, 0.2])
    assert front.interrupted
    assert front.values.tolist() == [0.5, 0.4]
    assert [one.ok for one in front.solutions] == [True, True]
    allowed = 0
    with pytest.raises(KeyboardInterrupt):
        al.pareto(bar_problem(), "stress", [0.5, 0.4])


def test_a_point_that_ctrl_c_has_cut_short_is_not_finished(monkeypatch):
    def solve(problem, **options):
        solution = al.solve(problem, **options)
        is_last = problem == bar_problem().with_bound("stress", 0.4)
        return replace(solution, status=al.Status.INTERRUPTED) if is_last else solution

    monkeypatch.setattr(_runner, "solve", solve)
    front = al.pareto(bar_problem(), "stress", [0.5, 0.4])
    assert front.interrupted
    assert front.values.tolist() == [0.5]


# --- Evidence at every design ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def strong():
    """Wide enough for a load that is normal: a margin is broken as often as its tables say."""
    limit = STRESS.at_most(0.5, sigmas=1.5).named("strong")
    bar = Bar(al.Decision(4.0, 0.1, 10.0), al.Normal(1.0, 0.2))
    return al.pareto(al.Problem(bar, minimize=MASS.mean, subject_to=[limit]), "strong", [0.5, 0.4])


def test_every_point_along_a_bound_has_the_share_of_its_normal_distribution(strong):
    found = al.validate_all(strong, 20_000)
    assert len(found.evidence) == 2
    for one in found.evidence:
        share = one.violations["strong"]
        assert share.lower <= norm.cdf(-1.5) <= share.upper
    assert found.agrees
    assert str(found).count(" to ") == 2


def test_a_trade_off_is_counted_against_the_problems_own_limits_alone(strong):
    front = al.trade_off(strong.solutions[0].problem, {"mass": MASS.mean, "stress": STRESS.mean}, 3)
    found = al.validate_all(front, 5000)
    assert [set(one.violations) for one in found.evidence] == [{"strong"}] * 3
    lightest = found.evidence[0].violations["strong"]  # as light as its limit lets it be
    assert lightest.lower <= norm.cdf(-1.5) <= lightest.upper
