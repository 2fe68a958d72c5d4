"""Systems are counted where the design holds its limits: between the instants of its grid too."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

import aleator as al
from zoo import LOSS, ONE_STEP, RESPONSE, Pendulum, gain_problem

FREE, STEPS, LIMIT, STD = 4, 7, 1.6, 0.2
ROUGHLY = 0.01  # so few steps give the effort to a quarter of a per cent
ENDS: dict[str, Any] = {"start": (0.0, 0.0), "end": (1.0, 0.0)}


class Sled(Pendulum):
    """A mass that is pushed one metre along a line."""

    def outputs(self, motion):
        return {"momentum": self.mass * motion.v[0]}


def sled_problem(**options):
    points = al.fit_control_points(np.linspace(0.0, 1.0, 40), FREE, **ENDS)
    motion = {"angle": al.BSpline(al.Decision(points, -5.0, 5.0), **ENDS)}
    defaults = {
        "grid": al.Grid(1.0, STEPS),
        "minimize": al.objectives.effort("angle_torque"),
        "subject_to": [al.path("momentum").at_most(LIMIT, sigmas=1.0)],
        "expansion": al.Expansion(order=2),
    }
    sled = Sled(mass=al.Uniform(1.0, std=STD), gravity=0.0)
    return al.Problem(al.InverseDynamics(sled, motion=motion), **(defaults | options))


def share_beyond(solution, instants):
    """How many masses have more momentum than the limit: by SciPy, from the control points of the clamped spline."""
    points = np.concatenate([[0.0, 0.0], np.ravel(solution.decisions["motion.angle.free"]), [1.0, 1.0]])
    knots = np.concatenate([np.zeros(4), np.linspace(0, 1, len(points) - 2)[1:-1], np.ones(4)])
    fastest = np.max(BSpline(knots, points, 3).derivative()(np.linspace(0, 1, instants)))
    return np.clip((1 + np.sqrt(3) * STD - LIMIT / fastest) / (2 * np.sqrt(3) * STD), 0, 1)


@pytest.fixture(scope="module")
def solution():
    return al.solve(sled_problem(), accuracy=ROUGHLY)


def test_the_share_that_breaks_a_limit_is_that_at_all_times_and_not_at_the_instants_of_the_grid(solution):
    truth, at_instants = (share_beyond(solution, instants) for instants in (10_001, STEPS + 1))
    evidence = al.validate(solution, 20_000, seed=2)
    share = evidence.violations["momentum"]
    assert share.lower <= truth <= share.upper
    assert at_instants < share.lower
    instants = solution.certificate.between.factor * STEPS + 1
    assert evidence.instants == instants
    assert instants > 100
    assert f"limits over time counted at {instants} instants" in str(evidence)


def test_a_design_that_holds_at_its_instants_alone_is_counted_there():
    coarse = al.solve(sled_problem(), between=1, accuracy=0.1)
    evidence = al.validate(coarse, 20_000, seed=2)
    share = evidence.violations["momentum"]
    assert share.lower <= share_beyond(coarse, STEPS + 1) <= share.upper
    assert share_beyond(coarse, 10_001) > share.upper
    assert evidence.instants == STEPS + 1


def test_moments_and_kept_systems_stay_those_of_the_design_s_own_grid(solution):
    # As though its error were an order below what is tolerated: otherwise all is sampled on a finer grid.
    certificate = dataclasses.replace(solution.certificate, grid_error=None)
    exact = dataclasses.replace(solution, certificate=certificate)
    fine = al.validate(exact, 300, batch=70, keep=300)
    blind = dataclasses.replace(exact, certificate=dataclasses.replace(certificate, between=None))
    coarse = al.validate(blind, 300, batch=70, keep=300)
    for text, one in coarse.functionals.items():
        np.testing.assert_array_equal(fine.functionals[text].mean, one.mean)
        np.testing.assert_array_equal(fine.functionals[text].std, one.std)
    for one, other in zip(fine.trajectories, coarse.trajectories, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
        assert one.values.shape == (300, STEPS + 1)
        assert one.violating.sum() == fine.violations["momentum"].count
    assert fine.violations["momentum"].count > coarse.violations["momentum"].count


@pytest.mark.slow
def test_calibration_counts_between_instants_too():
    target = 0.1
    found = al.calibrate(sled_problem(grid=al.Grid(1.0, 10)), "momentum", target, samples=4_000)
    error = 3 * np.sqrt(target / 4_000)
    assert found.confirmed
    assert target - 2 * error < share_beyond(found.solution, 10_001) < target
    assert found.evidence.instants == 10 * 10 + 1


def test_limits_that_say_nothing_of_one_system_are_named_with_the_reason():
    path = al.path("response")
    limits = [
        (al.objectives.norm(path.mean) <= 9.0).named("norm"),
        (path.std <= 9.0).named("spread"),
        RESPONSE.mean.equals(2.0).named("end"),
        (al.value("gain") <= 5.0).named("given"),
    ]
    evidence = al.validate(
        al.solve(al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)), 100
    )
    assert evidence.violations == {}
    assert evidence.instants is None
    assert list(evidence.uncounted.values()) == [
        "a function or an integral of statistics",
        "a statistic of all systems together",
        "an equality, which no single system meets",
        "numbers of the design alone",
    ]
    assert {one.name: one.meets for one in evidence.compared if one.name != "end"} == {"norm": True, "spread": True}
    text = str(evidence)
    assert "not counted: ‖μ[response(t)]‖ ≤ 9 for all t (a function or an integral of statistics)" in text
    assert "none can violate" not in text
