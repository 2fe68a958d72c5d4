"""Designs whose distributions are correlated: more germ variables than one stand behind a number."""

import numpy as np
import pytest
from scipy import optimize, stats

import aleator as al
from tiny_models import LOSS, ONE_STEP, RESPONSE, Gain

THETA_STD, SHIFT_STD, BOUND = 0.1, 0.2, 2.0


def correlated_problem(correlation):
    distributions = al.correlated(
        {"theta": al.Normal(1.0, THETA_STD), "shift": al.Normal(0.0, SHIFT_STD)}, {("theta", "shift"): correlation}
    )
    return al.Problem(
        Gain(al.Decision(0.5, 0.0, 10.0), distributions["theta"], distributions["shift"]),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[RESPONSE.at_most(BOUND, sigmas=1.0)],
        expansion=al.Expansion(2),
    )


def response_std(gain, correlation):
    return np.sqrt(gain**2 * THETA_STD**2 + SHIFT_STD**2 + 2 * gain * correlation * THETA_STD * SHIFT_STD)


@pytest.mark.parametrize("correlation", [-0.8, 0.0, 0.6])
def test_a_robust_design_and_its_evidence_know_the_correlation(correlation):
    solution = al.solve(correlated_problem(correlation))
    exact = optimize.brentq(lambda gain: gain + response_std(gain, correlation) - BOUND, 0.0, 3.0, xtol=1e-13)
    assert solution.decisions["gain"] == pytest.approx(exact, rel=1e-7)
    evidence = al.validate(solution, 20_000, seed=4)
    # The response is normal and its mean one standard deviation below the bound.
    violation = evidence.violations["response"]
    assert violation.lower <= stats.norm.sf(1.0) <= violation.upper
    sampled = evidence.functionals["response(t_f)"]
    assert float(sampled.std) == pytest.approx(response_std(exact, correlation), rel=0.02)


def test_a_problem_of_correlated_distributions_prints_and_is_diagnosed_by_its_numbers():
    text = str(correlated_problem(0.6))
    assert "in 2 variables" in text
    assert "theta ~ Normal" in text
    assert "shift ~ Normal" in text
