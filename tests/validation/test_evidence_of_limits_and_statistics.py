"""Systems are counted where the design holds its limits, and every statistic of a problem is estimated from them."""

from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.interpolate import BSpline

import aleator as al
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, Pendulum, gain_problem

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


# --- Statistics of problems, beside what the expansion says of them --------------------------------------------------


SAMPLES = 10_000
STATISTICS = [
    RESPONSE.mean,
    RESPONSE.variance,
    RESPONSE.quantile(0.9),
    RESPONSE.probability(above=3.3),
    RESPONSE.kurtosis,
    al.covariance(RESPONSE, al.terminal("gain")),
    RESPONSE.sobol("theta"),
    RESPONSE.quantile(0.9) - RESPONSE.quantile(0.1),
]


@pytest.fixture(scope="module")
def evidence():
    """Of the design of a problem in which these statistics stand, none of them active: the gain is 3."""
    limits = [
        al.Constraint(one, upper=1e3 if "P[" not in str(one) else 1.0, name=f"limit {i}")
        for i, one in enumerate(STATISTICS)
    ]
    solution = al.solve(al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits))
    assert solution.decisions["gain"] == pytest.approx(3.0, rel=1e-6)
    return al.validate(solution, SAMPLES, seed=3)


def test_estimates_and_their_standard_errors_are_those_of_statistics_on_the_samples(evidence):
    level, gain = 0.9, 3.0
    response = stats.uniform(gain * (1 - HALF_WIDTH), 2 * gain * HALF_WIDTH)
    variance, density = response.var(), 1 / (gain * 0.6)
    fourth, share = (gain * 0.3) ** 4 / 5, response.sf(3.3)
    # Of each: the truth, and the standard error of the textbook.
    expected = {
        "μ[response(t_f)]": (response.mean(), np.sqrt(variance / SAMPLES)),
        "Var[response(t_f)]": (variance, np.sqrt((fourth - variance**2) / SAMPLES)),
        "Q0.9[response(t_f)]": (response.ppf(level), np.sqrt(level * (1 - level) / SAMPLES) / density),
        "P": (share, np.sqrt(share * (1 - share) / SAMPLES)),
        "Kurt": (1.8, None),
    }
    for text, (truth, error) in expected.items():
        (checked,) = (one for name, one in evidence.statistics.items() if name.startswith(text))
        assert checked.expanded == pytest.approx(truth, rel=1e-2)
        assert abs(checked.estimate - truth) < 4 * checked.standard_error
        # A standard error from fifty groups is itself good to ten percent.
        assert error is None or checked.standard_error == pytest.approx(error, rel=0.4)
    assert evidence.statistics["Cov[response(t_f), gain(t_f)]"].estimate == pytest.approx(0.0, abs=1e-12)
    assert not any("S" in name.split("[")[0] and "theta" in name for name in evidence.statistics)  # a Sobol index


def test_limits_on_an_end_of_a_distribution_count_systems_and_limits_on_its_width_do_not(evidence):
    assert set(evidence.violations) == {"limit 0", "limit 2"}
