"""Every statistic of a problem estimated from the samples, beside what the expansion says of it."""

import numpy as np
import pytest
from scipy import optimize, stats

import aleator as al
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, Gain, gain_problem

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
    limits = [al.Constraint(one, upper=1e3, name=f"limit {i}") for i, one in enumerate(STATISTICS)]
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


def test_estimates_are_printed_beside_the_expansion(evidence):
    assert "Q0.9[response(t_f)]: 3.7" in str(evidence)
    assert "(expansion 3.72)" in str(evidence)


def test_limits_on_an_end_of_a_distribution_count_systems_and_limits_on_its_width_do_not(evidence):
    assert set(evidence.violations) == {"limit 0", "limit 2"}


@pytest.mark.slow
def test_a_deterministic_design_has_its_nominal_value_beside_the_estimate():
    limits = [RESPONSE.at_most(2.0, probability=0.9)]
    problem = al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)
    nominal = al.solve(al.deterministic(problem))
    checked = al.validate(nominal, 500).statistics["Q0.9[response(t_f)]"]
    assert checked.expanded == pytest.approx(2.0, rel=1e-6)
    assert checked.estimate > checked.expanded


# --- Correlated distributions ----------------------------------------------------------------------------------------

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


@pytest.mark.parametrize("correlation", [-0.8, 0.6])
def test_a_robust_design_and_its_evidence_know_the_correlation(correlation):
    """More germ variables than one stand behind a number."""

    def std(gain):
        return np.sqrt(gain**2 * THETA_STD**2 + SHIFT_STD**2 + 2 * gain * correlation * THETA_STD * SHIFT_STD)

    solution = al.solve(correlated_problem(correlation))
    exact = optimize.brentq(lambda gain: gain + std(gain) - BOUND, 0.0, 3.0, xtol=1e-13)
    assert solution.decisions["gain"] == pytest.approx(exact, rel=1e-7)
    evidence = al.validate(solution, 20_000, seed=4)
    # The response is normal and its mean one standard deviation below the bound.
    violation = evidence.violations["response"]
    assert violation.lower <= stats.norm.sf(1.0) <= violation.upper
    assert float(evidence.functionals["response(t_f)"].std) == pytest.approx(std(exact), rel=0.02)
    text = str(correlated_problem(correlation))
    for words in ("in 2 variables", "theta ~ Normal", "shift ~ Normal"):
        assert words in text
