import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.report import front_figure
from aleator.report._datasets import front_dataset
from aleator.sweep import _front as front_module
from aleator.transcription import EVALUATE
from tiny_models import LOSS, ONE_STEP, RESPONSE, SPREAD, Gain, gain_problem, oscillator_problem


def test_a_front_equals_independent_cold_solves():
    bounds = np.linspace(0.15, 0.11, 5)
    front = al.pareto(oscillator_problem(), "x", bounds)
    cold = [al.solve(oscillator_problem().with_bound("x", bound)) for bound in bounds]
    assert front.solved.all()
    assert not front.interrupted
    np.testing.assert_allclose(front.objectives, [one.objective for one in cold], rtol=1e-7)
    np.testing.assert_array_equal(front.values, bounds)
    assert sum(one.evaluations for one in front.solutions) < sum(one.evaluations for one in cold)


def test_a_front_is_compiled_once_and_follows_its_closed_form():
    problem = gain_problem()
    al.solve(problem)
    before = EVALUATE.compilations
    bounds = np.array([0.5, 1.0, 2.0, 3.0, 5.0])
    front = al.pareto(problem, "response", bounds)
    assert EVALUATE.compilations == before
    gains = np.minimum(3.0, bounds / (1 + SPREAD))
    np.testing.assert_allclose(front.objectives, (gains - 3) ** 2 + 1, rtol=1e-7)
    np.testing.assert_allclose(front.prices, 2 * (3 - gains) / (1 + SPREAD), rtol=1e-5, atol=1e-6)


def test_prices_are_the_slope_of_the_front():
    step, bound = 1e-5, 0.13
    front = al.pareto(oscillator_problem(), "x", [bound - step, bound, bound + step])
    slope = (front.objectives[2] - front.objectives[0]) / (2 * step)
    assert slope < -1e-3
    assert front.prices[1] == pytest.approx(-slope, rel=1e-3)


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
    assert np.isnan(front.prices[1:3]).all()
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
    (refused,) = (one for one in front.solutions if not one.ok)
    assert "whatever the decisions are" in refused.why()
    assert "whatever the decisions are" in str(front)
    assert np.isnan([refused.objective, refused.violation, refused.decisions["c"]]).all()
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

    monkeypatch.setattr(front_module, "solve", solve)
    front = al.pareto(gain_problem(), "response", [1.0, 2.0, 3.0, 4.0])
    assert front.interrupted
    assert front.values.tolist() == [1.0, 2.0]
    assert [one.ok for one in front.solutions] == [True, True]


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("response", [], "at least one value"),
        ("travel", [1.0], "There is no constraint 'travel'"),
        ("response", [1.0, np.nan], "expected numbers as bounds"),
    ],
)
def test_fronts_that_make_no_sense_are_refused(name, values, message):
    with pytest.raises(al.ProblemError, match=message):
        al.pareto(gain_problem(), name, values)


def normal_problem(sigmas=1.0, upper=2.0):
    """The response is normal: it violates `mean + sigmas std <= upper`, active, with probability 1 - Phi(sigmas)."""
    return gain_problem(upper=upper, sigmas=sigmas, theta=al.Normal(1.0, 0.2))


@pytest.mark.parametrize("first", [1.0, 3.0])
@pytest.mark.parametrize("target", [0.0228, 0.2])
def test_calibration_finds_the_margin_of_a_normal_response(target, first):
    samples = 20_000
    found = al.calibrate(normal_problem(first), "response", target, samples=samples)
    exact = stats.norm.isf(target)
    # The search ends up to 10 % below the target, and the sample itself is in error by its standard error.
    error = 3 * np.sqrt(target / samples) / stats.norm.pdf(exact)
    assert stats.norm.isf(target) - error <= found.sigmas <= stats.norm.isf(0.9 * target) + error
    assert found.solution.decisions["gain"] == pytest.approx(2.0 / (1 + 0.2 * found.sigmas), rel=1e-6)
    assert found.chosen.violation.estimate <= target
    # Fresh samples agree with the probability that this margin has in closed form.
    fresh = found.evidence.violations["response"]
    assert abs(fresh.estimate - stats.norm.sf(found.sigmas)) < 4 * np.sqrt(target / samples)
    # The trials were counted on other samples than those that a user draws with the same seed.
    again = al.validate(found.solution, found.evidence.samples, seed=0)
    assert again.violations == found.evidence.violations
    assert found.chosen.violation.samples == again.samples
    assert f"{found.sigmas:.4f}" in str(found)


def test_a_wide_target_ends_at_the_smallest_margin():
    found = al.calibrate(normal_problem(), "response", 0.9, samples=500)
    assert found.sigmas <= 0.02
    assert found.chosen.violation.estimate == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": 0.0}, "a probability between 0 and 1; received 0"),
        ({"target": 1.0}, "a probability between 0 and 1"),
        ({"target": -0.1}, "a probability between 0 and 1"),
        ({"target": np.nan}, "a probability between 0 and 1"),
        ({"target": 1e-4, "samples": 1000}, "needs at least 100000 samples to be counted; received 1000"),
        ({"name": "travel"}, "There is no constraint 'travel'"),
    ],
)
def test_calibrations_that_make_no_sense_are_refused(options, message):
    with pytest.raises(al.ProblemError, match=message):
        al.calibrate(normal_problem(), **({"name": "response", "samples": 2000, "target": 0.05} | options))


def test_calibration_of_a_constraint_without_spread_is_refused():
    with pytest.raises(al.ProblemError, match="hold no standard deviation; set sigmas=1"):
        al.calibrate(gain_problem(sigmas=0.0), "response", 0.1)


def least_gain_problem(least):
    return al.Problem(
        Gain(al.Decision(least, least, 10.0), al.Normal(1.0, 0.2)),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[RESPONSE.at_most(2.0, sigmas=1.0)],
    )


def test_a_margin_is_found_although_a_wider_one_has_no_design():
    # The margin exists up to (2 / least - 1) / 0.2 = 1.55; the first guess beyond 1 is 1.6.
    target = stats.norm.sf(1.4)
    found = al.calibrate(least_gain_problem(2.0 / 1.31), "response", target, samples=20_000)
    assert found.sigmas == pytest.approx(1.4, abs=0.1)


def test_a_target_that_no_design_reaches_is_an_error():
    with pytest.raises(
        al.SolveError, match=r"up to 1\.5\d* brought the violation of 'response' down to 0.01.* from 1\.55"
    ):
        al.calibrate(least_gain_problem(2.0 / 1.31), "response", 0.01, samples=2000)
    with pytest.raises(al.SolveError, match="'response' is violated by"):
        al.calibrate(least_gain_problem(1.9), "response", 0.01, samples=2000)


@pytest.mark.parametrize("solver", [al.FilterSQP(), al.Ipopt()], ids=lambda one: type(one).__name__)
def test_a_margin_that_does_not_matter_is_not_searched_for(solver):
    # The best gain is 3 and the response never gets near 100.
    found = al.calibrate(normal_problem(upper=100.0), "response", 0.1, samples=500, solver=solver)
    assert len(found.trials) == 1
    assert found.solution.decisions["gain"] == pytest.approx(3.0, rel=1e-5)
