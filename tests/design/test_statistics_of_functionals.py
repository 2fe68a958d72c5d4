from typing import ClassVar

import pytest

import aleator as al
from zoo import LOSS, ONE_STEP, RESPONSE, Gain, gain_problem, oscillator_problem

X, W = al.rms("x"), al.rms("w")


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (X.skewness, "Skew[rms(x)]"),
        (X.kurtosis, "Kurt[rms(x)]"),
        (X.supremum, "sup[rms(x)]"),
        (X.infimum, "inf[rms(x)]"),
        (X.quantile(0.99), "Q0.99[rms(x)]"),
        (X.sobol("k", "m"), "S(k, m)[rms(x)]"),
        (al.covariance(X, W), "Cov[rms(x), rms(w)]"),
        (al.correlation(X, W), "Corr[rms(x), rms(w)]"),
        (X.mean + 0.5 * X.supremum - al.covariance(X, W), "μ[rms(x)] + 0.5 sup[rms(x)] − Cov[rms(x), rms(w)]"),
    ],
)
def test_statistics_print_as_mathematics(expression, text):
    assert str(expression) == text


@pytest.mark.parametrize(
    ("constraint", "text"),
    [
        (X.at_most(2, probability=0.99), "Q0.99[rms(x)] ≤ 2"),
        (X.at_least(-2, probability=0.99), "Q0.01[rms(x)] ≥ -2"),
        (X.at_most(2, worst_case=True), "max[rms(x)] ≤ 2"),
        (al.path("x").at_least(-2, worst_case=True), "min[x(t)] ≥ -2 for all t"),
        (X.within(-1, 1, probability=0.9)[0], "Q0.9[rms(x)] ≤ 1"),
        (X.within(-1, 1, probability=0.9)[1], "Q0.1[rms(x)] ≥ -1"),
        (al.covariance(al.path("x"), al.path("v")) <= 1, "Cov[x(t), v(t)] ≤ 1 for all t"),
    ],
)
def test_limits_say_which_end_of_a_distribution_they_bound(constraint, text):
    assert str(constraint) == text


def test_a_limit_on_two_functionals_is_named_after_both():
    assert (al.covariance(al.rms("x"), al.rms("v")) <= 1).name == "x, v"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: X.at_most(1, sigmas=2, worst_case=True), r"expected one of .* received \['sigmas', 'worst_case'\]"),
        (lambda: X.at_most(1, probability=0.9, worst_case=True), r"received \['probability', 'worst_case'\]"),
        (lambda: X.probability(), "above"),
        (lambda: al.covariance(X, 1.0), r"A covariance is that of two functionals.*received float '1\.0'"),
    ],
)
def test_statistics_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


@pytest.mark.parametrize("index", [LOSS.sobol("thta"), LOSS.sobol("theta", "thta"), LOSS.total_sobol("thta")])
def test_a_sobol_index_of_an_unknown_germ_variable_is_refused_with_a_hint(index):
    problem = gain_problem()
    with pytest.raises(al.ProblemError, match=r"no germ variable 'thta'; expected one of \['theta'\]. Did you mean"):
        al.Problem(problem.system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[index <= 0.5])


def test_functionals_of_different_shapes_have_no_covariance():
    problem = oscillator_problem()
    with pytest.raises(al.ProblemError, match="have incompatible shapes"):
        oscillator_problem(subject_to=[al.covariance(al.path("x"), al.rms("v")) <= 1])
    assert problem.names == ("x",)


def test_the_unit_of_a_statistic_follows_from_what_it_is():
    from aleator.design import statistics_in
    from aleator.reporting._units import of_statistic

    class Spring(Gain):
        units: ClassVar = {"response": "N", "loss": "m"}

    problem = al.Problem(Spring(al.Decision(1.0), al.Uniform(1.0, half_width=0.1)), grid=ONE_STEP, minimize=LOSS.mean)
    units = [
        (RESPONSE.mean, "N"),
        (RESPONSE.quantile(0.9), "N"),
        (RESPONSE.supremum, "N"),
        (RESPONSE.variance, "N²"),
        (RESPONSE.skewness, ""),
        (RESPONSE.kurtosis, ""),
        (RESPONSE.probability(above=1.0), ""),
        (RESPONSE.sobol("theta"), ""),
        (RESPONSE.conditional_value_at_risk(0.9), "N"),
        (al.correlation(RESPONSE, LOSS), ""),
        (al.covariance(RESPONSE, RESPONSE), "N²"),
        (al.covariance(RESPONSE, LOSS), "N m"),
    ]
    for expression, unit in units:
        (atom,) = statistics_in((expression,))
        assert of_statistic(atom, problem) == unit
