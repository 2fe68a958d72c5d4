"""Limits at every collocation point, for distributions without bounds too."""

import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from zoo import Decay, optimum


class Bounded(al.AlgebraicSystem):
    """`y = gain a²`."""

    gain: al.Number
    a: al.Number

    def outputs(self):
        return {"y": self.gain * self.a**2}


Y = al.output("y")
AT_POINTS = Y.at_most(3.0, at_points=True)


def largest_gain(*limits, a=None):
    a = al.Normal(1.0, 0.5) if a is None else a
    return al.Problem(Bounded(al.Decision(0.1, 0.0, 10.0), a), minimize=-al.value("gain"), subject_to=limits)


def largest_square(problem):
    """The largest square of the uncertain number, of mean 1 and scale 0.5, at the collocation points."""
    points = np.asarray(transcribe(problem, al.Sequential()).collocation.points)
    return ((1.0 + 0.5 * points[:, 0]) ** 2).max()


def test_a_limit_at_the_points_of_an_unbounded_distribution_is_active_at_the_worst_of_them():
    assert str(AT_POINTS) == "max_k[y] ≤ 3"
    solution = al.solve(largest_gain(AT_POINTS))
    assert solution.decisions["gain"] == pytest.approx(3.0 / largest_square(solution.problem), rel=1e-7)
    (constraint,) = solution.constraints
    assert constraint.values == pytest.approx(3.0, rel=1e-7)
    assert constraint.active
    # Systems between the points may break it, and are counted.
    assert 0 < al.validate(solution, 20_000).violations["y"].estimate < 0.05


@pytest.mark.parametrize("most", [2.0, 4.0])
def test_limits_at_points_and_on_the_worst_case_stand_beside_each_other(most):
    limits = (AT_POINTS.named("points"), Y.at_most(most, worst_case=True).named("worst"))
    problem = largest_gain(*limits, a=al.Uniform(1.0, half_width=0.5))
    solution = al.solve(problem)
    expected = min(3.0 / largest_square(problem), most / 1.5**2)
    assert solution.decisions["gain"] == pytest.approx(expected, rel=1e-6)
    assert [one.name for one in solution.certificate.worst_case.realisations] == ["worst"]


@pytest.mark.parametrize("way", [al.Sequential(), al.Simultaneous()], ids=["shooting", "collocation"])
def test_limits_over_time_hold_at_each_point(way):
    problem = al.Problem(
        Decay(al.Normal(1.0, 0.1), start=al.Decision(1.0, 0.1, 9.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("start"),
        subject_to=[al.path("x").at_least(0.5, at_points=True)],
    )
    found = optimum(problem, transcription=way)
    points = np.asarray(found.transcribed.collocation.points)
    assert found.decisions["start"] == pytest.approx(0.5 * np.exp(1.0 + 0.1 * points.max()), rel=1e-5)


def test_without_uncertainty_it_is_the_limit_itself():
    assert optimum(al.deterministic(largest_gain(AT_POINTS))).decisions["gain"] == pytest.approx(3.0, rel=1e-7)


def test_one_meaning_of_a_limit_at_a_time():
    with pytest.raises(al.ProblemError, match="expected one of sigmas, probability, worst_case, at_points"):
        Y.at_most(1.0, at_points=True, worst_case=True)
    with pytest.raises(al.ProblemError, match="no place in an objective"):
        al.Problem(Bounded(al.Decision(1.0), al.Normal(0.0, 1.0)), minimize=AT_POINTS.expression)
