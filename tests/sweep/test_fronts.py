"""Fronts along a bound against their closed forms, and what becomes of points without a design."""

import contextlib
import signal

import numpy as np
import pytest

import aleator as al
from aleator.reporting import front_figure
from aleator.reporting._datasets import front_dataset
from aleator.sweep import _each as each_module
from zoo import SPREAD, Decay, bar_problem, gain_problem

NEEDED = 1.0 + 3.0 * SPREAD


def test_a_front_is_that_of_single_solves_and_of_the_closed_form():
    # The bar is at least 0.1 wide: weaker limits than that are idle.
    bounds = np.array([0.3, 0.5, 1.0, 2.0, 20.0])
    front = al.pareto(bar_problem(), "stress", bounds)
    assert front.solved.all()
    assert not front.interrupted
    assert front.objectives.tolist() == [al.solve(bar_problem(stress=bound)).objective for bound in bounds]
    np.testing.assert_allclose(front.objectives, np.maximum(NEEDED / bounds, 0.1), rtol=1e-6)
    np.testing.assert_allclose(
        front.shadow_prices, np.where(bounds < 10, NEEDED / bounds**2, 0.0), rtol=1e-5, atol=1e-6
    )
    assert front.neighbours == (None,) * len(bounds)
    np.testing.assert_array_equal(front.values, bounds)


@pytest.mark.slow
def test_fronts_and_starts_by_collocation_are_those_of_closed_forms():
    way, bounds = al.Simultaneous(al.schemes.GaussLegendre(1)), np.array([1.0, 2.0])
    optima = (bounds / (1 + SPREAD) - 3) ** 2 + 1
    front = al.pareto(gain_problem(), "response", bounds, transcription=way)
    np.testing.assert_allclose(front.objectives, optima, rtol=1e-7)
    starts = al.multistart(gain_problem(), 2, transcription=way)
    np.testing.assert_allclose([one.objective for one in starts.solutions], optima[1], rtol=1e-7)
    assert all(one.states is not None for one in (*front.solutions, *starts.solutions))


def test_infeasible_points_are_kept_with_their_least_violation():
    # The bar is at most 10 wide.
    front = al.pareto(bar_problem(), "stress", [0.5, 0.14, 0.1, 0.3])
    assert front.solved.tolist() == [True, False, False, True]
    assert [one.status for one in front.solutions[1:3]] == [al.Status.INFEASIBLE] * 2
    excess = [one.constraints[0].violation for one in front.solutions[1:3]]
    assert excess == pytest.approx([NEEDED / 10 - 0.14, NEEDED / 10 - 0.1], rel=1e-5)
    assert np.isnan(front.objectives[1:3]).all()
    assert np.isnan(front.shadow_prices[1:3]).all()
    assert (front.violations[1:3] > 0.01).all()
    assert front.violations[[0, 3]] == pytest.approx([0, 0], abs=1e-8)
    assert "infeasible" in str(front)
    assert "'stress' is violated by" in str(front)


def decaying():
    """A decay begins at one, whatever its rate: a lower bound is refused before anything is solved."""
    return al.Problem(
        Decay(al.Decision(1.0, 0.1, 4.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.terminal("x").mean,
        subject_to=[al.path("x").at_most(1.2), (al.terminal("x").mean >= 0.1).named("low")],
    )


def test_a_refused_point_is_kept_with_what_was_said_drawn_and_saved_and_the_others_are_solved():
    bounds = [0.9, 1.2, 1.1]
    front = al.pareto(decaying(), "x", bounds)
    assert front.values.tolist() == bounds
    assert front.solved.tolist() == [False, True, True]
    assert not front.interrupted
    np.testing.assert_allclose(front.objectives[1:], 0.1, rtol=1e-6)
    (refused,) = (one for one in front.points if not one.ok)
    assert refused not in front.solutions
    assert "whatever the decisions are" in refused.why()
    assert "whatever the decisions are" in str(front)
    assert np.isnan([front.objectives[0], front.violations[0], front.shadow_prices[0]]).all()
    figure = front_figure({"one": front}, x="limit", y="objective")
    hovered = [text for trace in figure.data for text in np.ravel(trace.customdata) if trace.customdata is not None]
    assert any("whatever the decisions are" in text for text in hovered)
    assert np.isnan(front_dataset(front)["objective"].values).tolist() == [True, False, False]


def test_a_front_of_which_every_point_is_refused_is_refused():
    with pytest.raises(al.ProblemError, match="whatever the decisions are"):
        al.pareto(decaying(), "x", [0.9, 0.8])


@pytest.mark.parametrize("at", [1, 3])
def test_ctrl_c_ends_a_front_with_the_points_that_are_finished_and_is_itself_where_there_are_none(monkeypatch, at):
    calls = []

    def solve(*arguments, **options):
        calls.append(arguments)
        if len(calls) == at:
            raise KeyboardInterrupt
        return al.solve(*arguments, **options)

    monkeypatch.setattr(each_module, "solve", solve)
    if at == 1:
        with pytest.raises(KeyboardInterrupt):
            al.pareto(bar_problem(), "stress", [0.5, 0.4])
        return
    front = al.pareto(bar_problem(), "stress", [0.5, 0.4, 0.3, 0.2])
    assert front.interrupted
    assert front.values.tolist() == [0.5, 0.4]
    assert [one.ok for one in front.solutions] == [True, True]


@pytest.mark.usefixtures("python_interrupts")
def test_a_ctrl_c_that_a_callback_swallows_ends_the_front_after_the_point():
    def swallow(task, done, total):
        # So do destructors and callbacks of the garbage collector, which Python lets no exception out of.
        if done == 1:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    front = al.pareto(bar_problem(), "stress", [0.5, 0.4, 0.3], progress=swallow)
    assert front.interrupted
    assert str(front).endswith("interrupted by the user")
    assert front.values.tolist() == [0.5]
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("stress", [], "at least one value"),
        ("travel", [1.0], "There is no constraint 'travel'"),
        ("stress", [1.0, np.nan], "expected a finite number; received nan"),
    ],
)
def test_fronts_that_make_no_sense_are_refused(name, values, message):
    with pytest.raises(al.ProblemError, match=message):
        al.pareto(bar_problem(), name, values)
