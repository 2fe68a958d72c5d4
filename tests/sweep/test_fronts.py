"""Fronts along a bound against their closed forms, what becomes of points without a design, and evidence along them."""

import warnings
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import aleator as al
from aleator.reporting import dataset, front_figure
from aleator.sweep import _runner
from zoo import MASS, SPREAD, STRESS, Bar, Decay, bar_problem

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


def decaying():
    """A decay begins at one, whatever its rate: a lower bound is refused before anything is solved."""
    return al.Problem(
        Decay(al.Decision(1.0, 0.1, 4.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.terminal("x").mean,
        subject_to=[al.path("x").at_most(1.2), (al.terminal("x").mean >= 0.1).named("low")],
    )


@pytest.mark.slow
def test_a_refused_point_is_kept_with_what_was_said_drawn_and_saved_and_the_others_are_solved():
    front = al.pareto(decaying(), "x", [0.9, 1.2])
    assert front.values.tolist() == [0.9, 1.2]
    assert front.solved.tolist() == [False, True]
    np.testing.assert_allclose(front.objectives[1:], 0.1, rtol=1e-6)
    refused = front.points[0]
    assert refused not in front.solutions
    assert "whatever the decisions are" in refused.why()
    assert "whatever the decisions are" in str(front)
    assert np.isnan([front.objectives[0], front.violations[0], front.shadow_prices[0]]).all()
    figure = front_figure({"one": front}, x="limit", y="objective")
    hovered = [text for trace in figure.data for text in np.ravel(trace.customdata) if trace.customdata is not None]
    assert any("whatever the decisions are" in text for text in hovered)
    assert np.isnan(dataset(front)["objective"].values).tolist() == [True, False]
    with pytest.raises(al.ProblemError, match="whatever the decisions are"):
        al.pareto(decaying(), "x", [0.9, 0.8])


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


class Root(al.AlgebraicSystem):
    """An output that the systems in a corner do not have where `a` is small: too few for a handful of fresh ones."""

    a: al.Number
    off: al.Number
    beside: al.Number
    third: al.Number

    def outputs(self):
        corner = (self.off > 0.35) & (self.beside > 0.35) & (self.a < 5.0)
        return {"x": jnp.where(corner, jnp.nan, self.a + self.off + self.third)}


def least(bound):
    """The smallest `a` above a bound; two points of collocation are too few to see the end of the model."""
    normals = [al.Normal(0.0, 0.2) for _ in range(3)]
    root = Root(al.Decision(8.5, bound, 9.0), *normals)
    with warnings.catch_warnings(action="ignore"):
        return al.solve(al.Problem(root, minimize=al.output("x").mean, expansion=al.Expansion(order=1)), throw=False)


@pytest.mark.slow
def test_designs_that_cannot_be_simulated_are_told_and_others_kept():
    found = al.validate_all([least(8.0), least(1.0)], 5000)
    assert [one is None for one in found.evidence] == [False, True]
    assert "not finite" in found.refused[1]
    assert not found.agrees
    assert "not finite" in str(found)
