import numpy as np
import pytest

import aleator as al
from tiny_models import LOSS, ONE_STEP, RESPONSE, Gain, gain_problem

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


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: al.Constraint(Y.mean, lower=2.0, upper=1.0),
        lambda: al.Constraint(Y.mean, upper=np.nan),
        lambda: Y.within(2.0, 1.0),
        lambda: Y.within(2.0, 1.0, sigmas=2.0),
        lambda: problem_with(Y.within(-1.0, 1.0)).with_bound("response", (2.0, 1.0)),
        lambda: problem_with(Y.within(-1.0, 1.0)).with_bound("response", -2.0),
        lambda: problem_with(Y.within(-1.0, 1.0)).with_bound("response", np.nan),
    ],
)
def test_bounds_in_the_wrong_order_are_refused(wrong):
    with pytest.raises(
        al.ProblemError,
        match=r"expected (lower <= upper; received lower=.*upper=|(numbers as bounds|a finite number); received .*nan)",
    ):
        wrong()


def problem_with(*constraints):
    """A problem with these constraints, moved to an output that it has."""
    here = [one for group in constraints for one in (group if isinstance(group, tuple) else (group,))]
    moved = [
        al.Constraint(RESPONSE.mean + 2.0 * RESPONSE.std, lower=one.lower, upper=one.upper, name="response")
        for one in here
    ]
    system = Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=al.Uniform(1.0, half_width=0.3))
    return al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=moved)


@pytest.mark.parametrize(
    ("constraints", "bound", "expected"),
    [
        ([Y.mean <= 1], 3.0, [(-np.inf, 3.0)]),
        ([Y.mean <= 1], -3.0, [(-np.inf, -3.0)]),
        ([Y.mean >= 1], 3.0, [(3.0, np.inf)]),
        ([Y.within(-1, 1)], 3.0, [(-np.inf, 3.0), (-3.0, np.inf)]),
        ([al.Constraint(Y.mean, lower=-1, upper=1)], 3.0, [(-3.0, 3.0)]),
        ([Y.within(0, 1)], (2.0, 5.0), [(-np.inf, 5.0), (2.0, np.inf)]),
        ([Y.mean >= 1], (2.0, np.inf), [(2.0, np.inf)]),
        ([Y.mean <= 1], (-np.inf, 3.0), [(-np.inf, 3.0)]),
        ([Y.mean.equals(1)], (2.0, 3.0), [(2.0, 3.0)]),
        ([Y.mean.equals(1)], 3.0, [(3.0, 3.0)]),
        ([Y.mean.equals(0)], 3.0, [(3.0, 3.0)]),
    ],
)
def test_a_bound_moves_the_side_that_is_closed(constraints, bound, expected):
    moved = problem_with(*constraints).with_bound("response", bound)
    assert [(one.lower, one.upper) for one in moved.constraints] == expected


def test_a_pair_that_is_not_symmetric_asks_for_both_bounds():
    with pytest.raises(al.ProblemError, match=r"bounds \[0.0\] and \[1.0\], which are not symmetric.*\(lower, upper\)"):
        problem_with(Y.within(0, 1)).with_bound("response", 2.0)


def limited_by(*constraints):
    """A problem with these constraints on an output that it has."""
    system = Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=al.Uniform(1.0, half_width=0.3))
    named = [one.named("limit") for one in constraints]
    return al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=named)


@pytest.mark.parametrize("limit", [RESPONSE.mean <= 1, RESPONSE.mean >= 1, 2 * RESPONSE.mean <= 1])
def test_two_bounds_make_a_limit_on_a_mean_one_of_two_sides(limit):
    (moved,) = limited_by(limit).with_bound("limit", (2.0, 3.0)).constraints
    assert (moved.lower, moved.upper) == (2.0, 3.0)


@pytest.mark.parametrize(
    "limits",
    [
        [RESPONSE.mean + 2 * RESPONSE.std <= 1],
        [RESPONSE.at_most(1, probability=0.9)],
        [RESPONSE.at_least(0, worst_case=True)],
        [RESPONSE.mean <= 1, LOSS.mean <= 1],
    ],
)
def test_two_bounds_of_limits_that_can_take_one_are_refused(limits):
    with pytest.raises(al.ProblemError, match=r"expected one number.*received \(2, 3\).*within\(lower, upper\)"):
        limited_by(*limits).with_bound("limit", (2.0, 3.0))


def test_an_unknown_constraint_is_refused_with_those_that_exist():
    with pytest.raises(al.ProblemError, match=r"no constraint 'travel'; expected one of \['response'\]"):
        gain_problem().with_bound("travel", 1.0)


def test_sigmas_of_a_problem_are_changed_by_name():
    other = gain_problem(sigmas=1.0).with_sigmas("response", 2.5)
    assert str(other.constraints[0]) == "μ[response(t_f)] + 2.5 σ[response(t_f)] ≤ 2"


@pytest.mark.parametrize("sigmas", [0.0, -1.0, np.inf, np.nan])
def test_sigmas_that_make_no_sense_are_refused(sigmas):
    with pytest.raises(al.ProblemError, match="sigmas: expected a positive number; received"):
        gain_problem().with_sigmas("response", sigmas)


def test_sigmas_of_a_constraint_without_spread_are_refused():
    problem = al.Problem(
        Gain(gain=al.Decision(0.5), theta=1.0), grid=ONE_STEP, minimize=LOSS.mean, subject_to=[RESPONSE.mean <= 2]
    )
    with pytest.raises(al.ProblemError, match="no standard deviation to scale"):
        problem.with_sigmas("response", 2.0)


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
    system = Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=al.Uniform(1.0, half_width=0.3))
    problem = al.Problem(
        system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[pair.named("stroke"), RESPONSE.within(0.0, 5.0)]
    )
    assert problem.names == ("stroke", "response")
    assert [(float(one.lower), float(one.upper)) for one in problem.named("stroke")] == [(-np.inf, 2.0), (-1.0, np.inf)]
    moved = problem.with_bound("stroke", (-3.0, 4.0)).named("stroke")
    assert [(float(one.lower), float(one.upper)) for one in moved] == [(-np.inf, 4.0), (-3.0, np.inf)]
    assert {one.name for one in pair.named("stroke")} == {"stroke"}
    with pytest.raises(al.ProblemError, match="Constraint: name"):
        pair.named(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("sigmas", [-1.0, np.nan, np.inf])
def test_a_margin_that_is_negative_or_not_finite_is_refused(sigmas):
    with pytest.raises(al.ProblemError, match=r"sigmas must not be negative|Only finite numbers can multiply"):
        al.path("x").at_most(1.0, sigmas=sigmas)


def test_a_constraint_without_a_finite_bound_is_refused():
    with pytest.raises(al.ProblemError, match="bounds nothing"):
        al.Constraint(Y.mean, lower=-np.inf)
    with pytest.raises(al.ProblemError, match="Only finite numbers can be added to or compared"):
        al.path("x").at_most(np.inf)


@pytest.mark.parametrize(
    "mistake",
    [
        lambda y: y <= 5.0,
        lambda y: y >= 5.0,
        lambda y: 2 * y,
        lambda y: y + y,
        lambda y: 1.0 - y,
        lambda y: -y,
        lambda y: y.mean + y,
        lambda y: y.mean * y,
        lambda y: 1.0 / y,
        lambda y: y**2,
    ],
)
def test_arithmetic_on_a_functional_without_a_statistic_is_refused_in_words(mistake):
    with pytest.raises(al.ProblemError, match=r"differs between realisations: take a statistic of it"):
        mistake(al.rms("x"))


def test_strict_comparisons_are_refused_in_words():
    with pytest.raises(al.ProblemError, match="write <= or >="):
        al.rms("x").mean < 1.0  # noqa: B015


def test_an_equality_sign_in_the_place_of_equals_is_refused_with_a_hint():
    problem = gain_problem()
    with pytest.raises(al.ProblemError, match=r"For an equality write expression\.equals"):
        al.Problem(problem.system, grid=problem.grid, minimize=problem.objective, subject_to=[al.rms("x").mean == 5.0])


@pytest.mark.parametrize("which", ["at_points", "worst_case"])
@pytest.mark.parametrize("value", ["yes", None, 1])
def test_what_is_neither_true_nor_false_is_refused(which, value):
    with pytest.raises(al.ProblemError, match=rf"'response\(t_f\)': {which}: expected True or False; received"):
        RESPONSE.at_most(1.0, **{which: value})
