"""Every statistic of a problem estimated from the samples, beside what the expansion says of it."""

import numpy as np
import pytest
from scipy import stats

import aleator as al
from tiny_models import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, gain_problem, oscillator_problem

THETA = stats.uniform(1.0 - HALF_WIDTH, 2 * HALF_WIDTH)
SAMPLES = 10_000


def solved(*constraints, bound=1e3):
    """The design of a problem in which these statistics stand, none of them active: the gain is 3."""
    system = gain_problem().system
    limits = [al.Constraint(one, upper=bound, name=f"limit {i}") for i, one in enumerate(constraints)]
    return al.solve(al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits))


def test_estimates_and_their_standard_errors_are_those_of_statistics_on_the_samples():
    level = 0.9
    solution = solved(
        RESPONSE.mean, RESPONSE.variance, RESPONSE.quantile(level), RESPONSE.probability(above=3.3), RESPONSE.kurtosis
    )
    gain = solution.decisions["gain"]
    assert gain == pytest.approx(3.0, rel=1e-6)
    found = al.validate(solution, SAMPLES, seed=3).statistics
    response = stats.uniform(gain * 0.7, gain * 0.6)
    variance, density = response.var(), 1 / (gain * 0.6)
    fourth = (gain * 0.3) ** 4 / 5
    share = response.sf(3.3)
    # Of each: the truth, and the standard error of the textbook.
    expected = {
        "μ[response(t_f)]": (response.mean(), np.sqrt(variance / SAMPLES)),
        "Var[response(t_f)]": (variance, np.sqrt((fourth - variance**2) / SAMPLES)),
        "Q0.9[response(t_f)]": (response.ppf(level), np.sqrt(level * (1 - level) / SAMPLES) / density),
        "P": (share, np.sqrt(share * (1 - share) / SAMPLES)),
        "Kurt": (1.8, None),
    }
    assert set(found) >= {"μ[response(t_f)]", "Var[response(t_f)]", "Q0.9[response(t_f)]"}
    for text, (truth, error) in expected.items():
        (checked,) = (one for name, one in found.items() if name.startswith(text))
        assert checked.expanded == pytest.approx(truth, rel=1e-2)
        assert abs(checked.estimate - truth) < 4 * checked.standard_error
        # A standard error from fifty groups is itself good to ten percent.
        assert error is None or checked.standard_error == pytest.approx(error, rel=0.4)


def test_a_covariance_is_estimated_and_a_sobol_index_is_left_out():
    solution = solved(
        al.covariance(RESPONSE, al.terminal("gain")), RESPONSE.sobol("theta"), al.path("response").variance
    )
    found = al.validate(solution, 500).statistics
    assert set(found) == {"μ[loss(t_f)]", "Cov[response(t_f), gain(t_f)]"}
    assert found["Cov[response(t_f), gain(t_f)]"].estimate == pytest.approx(0.0, abs=1e-12)


def test_evidence_prints_estimates_beside_the_expansion():
    text = str(al.validate(solved(RESPONSE.quantile(0.9)), 2000))
    assert "Q0.9[response(t_f)]: 3.7" in text
    assert "(expansion 3.72)" in text


@pytest.mark.slow
def test_limits_on_an_end_of_a_distribution_count_systems_and_limits_on_its_width_do_not():
    solution = solved(
        RESPONSE.quantile(0.9),
        RESPONSE.quantile(0.9) - RESPONSE.quantile(0.1),
        RESPONSE.supremum - RESPONSE.infimum,
        RESPONSE.supremum,
        RESPONSE.probability(above=3.5),
        RESPONSE.skewness,
    )
    assert set(al.validate(solution, 200).violations) == {"limit 0", "limit 3"}


def test_the_share_of_systems_beyond_a_quantile_is_one_minus_its_level():
    problem = gain_problem()
    limited = al.Problem(
        problem.system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[RESPONSE.at_most(2.0, probability=0.95)]
    )
    evidence = al.validate(al.solve(limited), SAMPLES, seed=5)
    violation = evidence.violations["response"]
    assert violation.lower <= 0.05 <= violation.upper


@pytest.mark.slow
def test_a_deterministic_design_has_its_nominal_value_beside_the_estimate():
    nominal = al.solve(al.deterministic(oscillator_problem(minimize=al.rms("v").quantile(0.9) + 0.1 * al.value("c"))))
    checked = al.validate(nominal, 500).statistics["Q0.9[rms(v)]"]
    assert checked.expanded == pytest.approx(float(nominal.moments["rms(v)"].mean), rel=1e-9)
    assert checked.estimate > checked.expanded
