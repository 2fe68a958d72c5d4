"""Limits at every collocation point, for distributions without bounds too."""

from typing import Any

import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe


class Bounded(al.AlgebraicSystem):
    """`y = gain a² + b`, without unknowns."""

    unknowns = ()
    gain: Any
    a: Any
    b: Any = 0.0

    def outputs(self):
        return {"y": self.gain * self.a**2 + self.b}


Y = al.output("y")


def largest_gain(*limits, **numbers):
    given = {"a": al.Normal(1.0, 0.5), "b": 0.0} | numbers
    return al.Problem(Bounded(gain=al.Decision(0.1, 0.0, 10.0), **given), minimize=-al.value("gain"), subject_to=limits)


def largest_square(problem):
    """The largest square of the uncertain number, of mean 1 and scale 0.5, at the collocation points."""
    points = np.asarray(transcribe(problem, al.Sequential()).collocation.points)
    return ((1.0 + 0.5 * points[:, 0]) ** 2).max()


def test_a_limit_at_the_points_of_an_unbounded_distribution_is_active_at_the_worst_of_them():
    limit = Y.at_most(3.0, at_points=True)
    assert str(limit) == "max_k[y] ≤ 3"
    solution = al.solve(largest_gain(limit))
    assert solution.decisions["gain"] == pytest.approx(3.0 / largest_square(solution.problem), rel=1e-7)
    (constraint,) = solution.constraints
    assert constraint.values == pytest.approx(3.0, rel=1e-7)
    assert constraint.active


def test_systems_between_the_points_may_break_it_and_evidence_counts_them():
    solution = al.solve(largest_gain(Y.at_most(3.0, at_points=True)))
    share = al.validate(solution, 20_000).violations["y"]
    assert 0 < share.estimate < 0.05


@pytest.mark.parametrize("most", [2.0, 4.0])
def test_limits_at_points_and_on_the_worst_case_stand_beside_each_other(most):
    limits = (Y.at_most(3.0, at_points=True).named("points"), Y.at_most(most, worst_case=True).named("worst"))
    problem = largest_gain(*limits, a=al.Uniform(1.0, half_width=0.5))
    solution = al.solve(problem)
    expected = min(3.0 / largest_square(problem), most / 1.5**2)
    assert solution.decisions["gain"] == pytest.approx(expected, rel=1e-6)
    assert [one.name for one in solution.certificate.worst_case.realisations] == ["worst"]


def test_over_time_and_in_both_transcriptions():
    class Decay(al.System):
        states = ("x",)
        rate: Any
        start: Any = 1.0

        def initial(self):
            return {"x": self.start}

        def rhs(self, t, z):
            return (-self.rate * z.x,)

        def outputs(self, t, z):
            return {"x": z.x}

    problem = al.Problem(
        Decay(al.Normal(1.0, 0.1), start=al.Decision(1.0, 0.1, 9.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("start"),
        subject_to=[al.path("x").at_least(0.5, at_points=True)],
    )
    points = np.asarray(transcribe(problem, al.Sequential()).collocation.points)
    expected = 0.5 * np.exp(1.0 + 0.1 * points.max())
    for transcription in (al.Sequential(), al.Simultaneous()):
        found = al.solve(problem, transcription=transcription)
        assert found.decisions["start"] == pytest.approx(expected, rel=1e-5)


def test_one_meaning_of_a_limit_at_a_time():
    with pytest.raises(al.ProblemError, match="expected one of sigmas, probability, worst_case, at_points"):
        Y.at_most(1.0, at_points=True, worst_case=True)
    with pytest.raises(al.ProblemError, match="no place in an objective"):
        al.Problem(Bounded(al.Decision(1.0), al.Normal(0.0, 1.0)), minimize=Y.at_most(1.0, at_points=True).expression)


def test_without_uncertainty_it_is_the_limit_itself():
    problem = al.deterministic(largest_gain(Y.at_most(3.0, at_points=True)))
    assert al.solve(problem).decisions["gain"] == pytest.approx(3.0, rel=1e-7)
