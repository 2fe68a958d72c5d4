import numpy as np
import pytest

import aleator as al
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, Gain, gain_problem

Y, PATH = al.rms("y"), al.path("y")


@pytest.mark.parametrize(
    ("constraint", "bounds", "name", "text"),
    [
        (Y.mean <= 2, (-np.inf, 2.0), "y", "μ[rms(y)] ≤ 2"),
        (-Y.mean <= 3, (-np.inf, 3.0), "y", "−μ[rms(y)] ≤ 3"),
        (Y.mean + 3 <= 2, (-np.inf, -1.0), "y", "μ[rms(y)] ≤ -1"),
        (Y.mean >= 2, (2.0, np.inf), "y", "μ[rms(y)] ≥ 2"),
        (Y.mean <= al.value("k.std"), (-np.inf, 0.0), "y, k.std", "μ[rms(y)] − k.std ≤ 0"),
        (Y.mean.equals(4), (4.0, 4.0), "y", "μ[rms(y)] = 4"),
        (Y.at_most(2), (-np.inf, 2.0), "y", "μ[rms(y)] ≤ 2"),
        (Y.at_most(2, sigmas=3), (-np.inf, 2.0), "y", "μ[rms(y)] + 3 σ[rms(y)] ≤ 2"),
        (Y.at_least(-2, sigmas=1), (-2.0, np.inf), "y", "μ[rms(y)] − σ[rms(y)] ≥ -2"),
        (PATH.at_most(1, sigmas=1.5), (-np.inf, 1.0), "y", "μ[y(t)] + 1.5 σ[y(t)] ≤ 1 for all t"),
        (PATH.within(-1, 2, sigmas=1)[0], (-np.inf, 2.0), "y", "μ[y(t)] + σ[y(t)] ≤ 2 for all t"),
        (PATH.within(-1, 2, sigmas=1)[1], (-1.0, np.inf), "y", "μ[y(t)] − σ[y(t)] ≥ -1 for all t"),
        (al.Constraint(Y.mean, lower=0, upper=1, name="both"), (0.0, 1.0), "both", "0 ≤ μ[rms(y)] ≤ 1"),
        ((Y.mean <= 2).named("noise"), (-np.inf, 2.0), "noise", "μ[rms(y)] ≤ 2"),
    ],
)
def test_constraints_say_what_they_bound(constraint, bounds, name, text):
    assert (constraint.lower, constraint.upper) == bounds
    assert constraint.name == name
    assert str(constraint) == text
    assert constraint.is_path is ("for all t" in text)


MODEL = Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=al.Uniform(1.0, half_width=HALF_WIDTH))


def problem_with(*constraints):
    """A problem with these constraints, moved to an output that it has."""
    here = [one for group in constraints for one in (group if isinstance(group, tuple) else (group,))]
    moved = [
        al.Constraint(RESPONSE.mean + 2.0 * RESPONSE.std, lower=one.lower, upper=one.upper, name="response")
        for one in here
    ]
    return al.Problem(MODEL, grid=ONE_STEP, minimize=LOSS.mean, subject_to=moved)


@pytest.mark.parametrize(
    ("constraints", "bound", "expected"),
    [
        ([Y.mean <= 1], 3.0, [(-np.inf, 3.0)]),
        ([Y.mean >= 1], 3.0, [(3.0, np.inf)]),
        ([Y.within(-1, 1)], 3.0, [(-np.inf, 3.0), (-3.0, np.inf)]),
        ([al.Constraint(Y.mean, lower=-1, upper=1)], 3.0, [(-3.0, 3.0)]),
        ([Y.within(0, 1)], (2.0, 5.0), [(-np.inf, 5.0), (2.0, np.inf)]),
        ([Y.mean <= 1], (-np.inf, 3.0), [(-np.inf, 3.0)]),
        ([Y.mean.equals(1)], (2.0, 3.0), [(2.0, 3.0)]),
        ([Y.mean.equals(1)], 3.0, [(3.0, 3.0)]),
    ],
)
def test_a_bound_moves_the_side_that_is_closed(constraints, bound, expected):
    moved = problem_with(*constraints).with_bound("response", bound)
    assert [(one.lower, one.upper) for one in moved.constraints] == expected


def limited_by(*constraints):
    """A problem with these constraints on an output that it has."""
    named = [one if isinstance(one, bool) else one.named("limit") for one in constraints]
    return al.Problem(MODEL, grid=ONE_STEP, minimize=LOSS.mean, subject_to=named)


def test_two_bounds_make_a_limit_on_a_mean_one_of_two_sides():
    for limit in (RESPONSE.mean <= 1, RESPONSE.mean >= 1, 2 * RESPONSE.mean <= 1):
        (moved,) = limited_by(limit).with_bound("limit", (2.0, 3.0)).constraints
        assert (moved.lower, moved.upper) == (2.0, 3.0)


def test_sigmas_of_a_problem_are_changed_by_name():
    other = gain_problem(sigmas=1.0).with_sigmas("response", 2.5)
    assert str(other.constraints[0]) == "μ[response(t_f)] + 2.5 σ[response(t_f)] ≤ 2"


def test_constraints_on_one_output_that_measure_different_things_are_told_apart():
    told = al.Problem(
        gain_problem().system,
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[al.path("response").at_most(20.0), al.terminal("response").at_most(5.0, sigmas=3.0)],
    )
    assert told.names == ("response(t)", "response(t_f)")
    moved = told.with_bound("response(t_f)", 4.0)
    assert [float(one.upper) for one in moved.constraints] == [20.0, 4.0]


def test_the_two_sides_of_one_limit_keep_one_name():
    pair = al.path("x").within(-1.0, 1.0, sigmas=2.0)
    assert {one.name for one in pair} == {"x"}
    assert str(pair) == f"{pair.at_least} and {pair.at_most}"


def test_both_sides_of_a_range_are_named_at_once():
    pair = LOSS.within(-1.0, 2.0, sigmas=1.0)
    problem = al.Problem(
        MODEL, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[pair.named("stroke"), RESPONSE.within(0.0, 5.0)]
    )
    assert problem.names == ("stroke", "response")
    assert [(float(one.lower), float(one.upper)) for one in problem.named("stroke")] == [(-np.inf, 2.0), (-1.0, np.inf)]
    moved = problem.with_bound("stroke", (-3.0, 4.0)).named("stroke")
    assert [(float(one.lower), float(one.upper)) for one in moved] == [(-np.inf, 4.0), (-3.0, np.inf)]
    assert {one.name for one in pair.named("stroke")} == {"stroke"}


TWO = {"bound": (2.0, 3.0), "name": "limit"}
ONE_NUMBER = r"expected one number.*received \(2, 3\).*within\(lower, upper\)"
UNSEEN = r"differs between realisations: take a statistic of it"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.Constraint(Y.mean, lower=2.0, upper=1.0), "lower <= upper; received lower=2"),
        (lambda: Y.within(2.0, 1.0, sigmas=2.0), "lower <= upper; received lower=2"),
        (lambda: problem_with(Y.within(-1.0, 1.0)).with_bound("response", (2.0, 1.0)), "lower <= upper; received"),
        (lambda: problem_with(Y.within(-1.0, 1.0)).with_bound("response", -2.0), "lower <= upper; received"),
        (lambda: problem_with(Y.within(0, 1)).with_bound("response", 2.0), r"not symmetric.*\(lower, upper\)"),
        (lambda: limited_by(RESPONSE.mean + 2 * RESPONSE.std <= 1).with_bound(**TWO), ONE_NUMBER),
        (lambda: limited_by(RESPONSE.at_most(1, probability=0.9)).with_bound(**TWO), ONE_NUMBER),
        (lambda: limited_by(RESPONSE.at_least(0, worst_case=True)).with_bound(**TWO), ONE_NUMBER),
        (lambda: limited_by(RESPONSE.mean <= 1, LOSS.mean <= 1).with_bound(**TWO), ONE_NUMBER),
        (lambda: gain_problem().with_bound("travel", 1.0), r"no constraint 'travel'; expected one of \['response'\]"),
        (lambda: gain_problem().with_sigmas("response", 0.0), "sigmas: expected a positive number; received"),
        (lambda: limited_by(RESPONSE.mean <= 2).with_sigmas("limit", 2.0), "no standard deviation to scale"),
        (lambda: al.path("x").at_most(1.0, sigmas=-1.0), "sigmas must not be negative"),
        (lambda: al.Constraint(Y.mean, lower=-np.inf), "bounds nothing"),
        (lambda: al.path("x").at_most(np.inf), "Only finite numbers can be added to or compared"),
        (lambda: Y <= 5.0, UNSEEN),
        (lambda: Y >= 5.0, UNSEEN),
        (lambda: 2 * Y, UNSEEN),
        (lambda: Y + Y, UNSEEN),
        (lambda: 1.0 - Y, UNSEEN),
        (lambda: -Y, UNSEEN),
        (lambda: Y.mean + Y, UNSEEN),
        (lambda: Y.mean * Y, UNSEEN),
        (lambda: 1.0 / Y, UNSEEN),
        (lambda: Y**2, UNSEEN),
        (lambda: Y.mean < 1.0, "write <= or >="),
        (
            lambda: al.Problem(MODEL, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[Y.mean == 5.0]),
            r"equality write expression\.equals",
        ),
    ],
)
def test_limits_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()
