import contextlib
import signal

import numpy as np
import pytest

import aleator as al
from aleator.reporting import front_figure
from aleator.reporting._datasets import front_dataset
from aleator.sweep import _each as each_module
from aleator.transcription.sequential import EVALUATE
from tiny_models import LOSS, ONE_STEP, RESPONSE, SPREAD, Gain, gain_problem, oscillator_problem


def test_a_front_without_doubts_is_that_of_single_solves():
    bounds = np.linspace(0.15, 0.11, 5)
    front = al.pareto(oscillator_problem(), "x", bounds)
    cold = [al.solve(oscillator_problem().with_bound("x", bound)) for bound in bounds]
    assert front.solved.all()
    assert not front.interrupted
    assert front.objectives.tolist() == [one.objective for one in cold]
    assert front.neighbours == (None,) * len(bounds)
    np.testing.assert_array_equal(front.values, bounds)


def test_a_front_is_compiled_once_and_follows_its_closed_form():
    problem = gain_problem()
    al.solve(problem)
    before = EVALUATE.compilations
    bounds = np.array([0.5, 1.0, 2.0, 3.0, 5.0])
    front = al.pareto(problem, "response", bounds)
    assert EVALUATE.compilations == before
    gains = np.minimum(3.0, bounds / (1 + SPREAD))
    np.testing.assert_allclose(front.objectives, (gains - 3) ** 2 + 1, rtol=1e-7)
    np.testing.assert_allclose(front.shadow_prices, 2 * (3 - gains) / (1 + SPREAD), rtol=1e-5, atol=1e-6)


def test_a_front_and_starts_by_direct_collocation_follow_the_closed_form():
    way, bounds = al.Simultaneous(al.schemes.GaussLegendre(2)), np.array([1.0, 2.0])
    front = al.pareto(gain_problem(), "response", bounds, transcription=way)
    optima = (np.minimum(3.0, bounds / (1 + SPREAD)) - 3) ** 2 + 1
    np.testing.assert_allclose(front.objectives, optima, rtol=1e-7)
    assert all(one.states is not None for one in front.solutions)
    starts = al.multistart(gain_problem().with_bound("response", 2.0), 2, transcription=way)
    np.testing.assert_allclose([one.objective for one in starts.solutions], optima[1], rtol=1e-7)
    assert all(one.states is not None for one in starts.solutions)


def test_shadow_prices_are_the_slope_of_the_front():
    step, bound = 1e-3, 0.13
    # So many steps that margins for what lies between the instants, which move with the bound too, are negligible.
    front = al.pareto(oscillator_problem(grid=al.Grid(4.0, 400)), "x", [bound - step, bound, bound + step])
    slope = (front.objectives[2] - front.objectives[0]) / (2 * step)
    assert slope < -1e-3
    assert front.shadow_prices[1] == pytest.approx(-slope, rel=1e-3)


def test_infeasible_points_are_kept_with_their_least_violation():
    # The response is at least 1 at the least gain of 1: bounds below 1 + SPREAD cannot be met.
    problem = al.Problem(
        Gain(al.Decision(1.5, 1.0, 10.0), al.Uniform(1.0, half_width=SPREAD * np.sqrt(3.0))),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[RESPONSE.at_most(2.0, sigmas=1.0)],
    )
    front = al.pareto(problem, "response", [2.0, 1.0, 0.5, 1.5])
    assert front.solved.tolist() == [True, False, False, True]
    assert [one.status for one in front.solutions[1:3]] == [al.Status.INFEASIBLE] * 2
    excess = [one.constraints[0].violation for one in front.solutions[1:3]]
    assert excess == pytest.approx([SPREAD, SPREAD + 0.5], rel=1e-6)
    assert np.isnan(front.objectives[1:3]).all()
    assert np.isnan(front.shadow_prices[1:3]).all()
    assert (front.violations[1:3] > 0.01).all()
    assert front.violations[[0, 3]] == pytest.approx([0, 0], abs=1e-8)
    assert "infeasible" in str(front)
    assert "'response' is violated by" in str(front)


def pushed_problem():
    """The mass starts at zero, whatever the damper: a bound above that is refused before anything is solved."""
    return oscillator_problem(subject_to=[al.path("x").at_least(-0.14, sigmas=2.0)])


@pytest.mark.parametrize("bounds", [[-0.14, -0.15, 0.1], [0.1, -0.14, -0.15]], ids=["last", "first"])
def test_a_refused_point_is_kept_with_what_was_said_and_the_others_are_solved(bounds):
    front = al.pareto(pushed_problem(), "x", bounds)
    assert front.values.tolist() == bounds
    assert front.solved.tolist() == [bound < 0 for bound in bounds]
    assert not front.interrupted
    cold = [al.solve(pushed_problem().with_bound("x", bound)).objective for bound in bounds if bound < 0]
    np.testing.assert_allclose(front.objectives[front.solved], cold, rtol=1e-7)
    (refused,) = (one for one in front.points if not one.ok)
    assert refused not in front.solutions
    assert "whatever the decisions are" in refused.why()
    assert "whatever the decisions are" in str(front)
    where = bounds.index(0.1)
    assert np.isnan([front.objectives[where], front.violations[where], front.shadow_prices[where]]).all()
    assert float(refused.problem.named("x")[0].lower) == 0.1


def test_a_front_of_which_every_point_is_refused_is_refused():
    with pytest.raises(al.ProblemError, match="whatever the decisions are"):
        al.pareto(pushed_problem(), "x", [0.1, 0.2])


def test_a_front_with_a_refused_point_can_be_drawn_and_saved(tmp_path):
    front = al.pareto(pushed_problem(), "x", [-0.14, 0.1])
    figure = front_figure({"one": front}, x="limit", y="objective")
    hovered = [text for trace in figure.data for text in np.ravel(trace.customdata) if trace.customdata is not None]
    assert any("whatever the decisions are" in text for text in hovered)
    saved = front_dataset(front)
    assert np.isnan(saved["objective"].values).tolist() == [False, True]
    page = al.report(front.solutions[0], fronts=front, path=tmp_path / "page.html")
    assert "whatever the decisions are" in page.read_text(encoding="utf-8")


def test_ctrl_c_ends_a_front_with_the_points_that_are_finished(monkeypatch):
    calls = []

    def solve(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return al.solve(*arguments, **options)

    monkeypatch.setattr(each_module, "solve", solve)
    front = al.pareto(gain_problem(), "response", [1.0, 2.0, 3.0, 4.0])
    assert front.interrupted
    assert front.values.tolist() == [1.0, 2.0]
    assert [one.ok for one in front.solutions] == [True, True]


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("response", [], "at least one value"),
        ("travel", [1.0], "There is no constraint 'travel'"),
        ("response", [1.0, np.nan], "expected a finite number; received nan"),
    ],
)
def test_fronts_that_make_no_sense_are_refused(name, values, message):
    with pytest.raises(al.ProblemError, match=message):
        al.pareto(gain_problem(), name, values)


def test_ctrl_c_before_the_first_point_is_ctrl_c(monkeypatch):
    def solve(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(each_module, "solve", solve)
    with pytest.raises(KeyboardInterrupt):
        al.pareto(gain_problem(), "response", [1.0, 2.0])


@pytest.mark.usefixtures("python_interrupts")
def test_a_ctrl_c_that_a_callback_swallows_ends_the_front_after_the_point():
    def swallow(task, done, total):
        # So do destructors and callbacks of the garbage collector, which Python lets no exception out of.
        if done == 1:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    front = al.pareto(gain_problem(), "response", [1.0, 2.0, 3.0, 4.0], progress=swallow)
    assert front.interrupted
    assert str(front).endswith("interrupted by the user")
    assert front.values.tolist() == [1.0]
    assert signal.getsignal(signal.SIGINT) is before
