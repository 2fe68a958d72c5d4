from typing import ClassVar

import numpy as np
import pytest

import aleator as al
from zoo import (
    HALF_WIDTH,
    LOSS,
    MASS,
    ONE_STEP,
    RESPONSE,
    SPREAD,
    STRESS,
    Gain,
    bar_problem,
    cases,
    gain_problem,
    optimum,
)

Y, PATH = al.rms("y"), al.path("y")


@pytest.mark.parametrize(
    ("constraint", "bounds", "name", "text"),
    [
        (Y.mean <= 2, (-np.inf, 2.0), "y", "μ[rms(y)] ≤ 2"),
        (Y.mean >= 2, (2.0, np.inf), "y", "μ[rms(y)] ≥ 2"),
        (Y.mean <= al.value("k.std"), (-np.inf, 0.0), "y, k.std", "μ[rms(y)] − k.std ≤ 0"),
        (PATH.at_most(1, sigmas=1.5), (-np.inf, 1.0), "y", "μ[y(t)] + 1.5 σ[y(t)] ≤ 1 for all t"),
        (PATH.within(-1, 2, sigmas=1)[0], (-np.inf, 2.0), "y", "μ[y(t)] + σ[y(t)] ≤ 2 for all t"),
        (Y.at_least(-2, probability=0.99), (-2.0, np.inf), "y", "Q0.01[rms(y)] ≥ -2"),
        (PATH.within(-1, 2, sigmas=1)[1], (-1.0, np.inf), "y", "μ[y(t)] − σ[y(t)] ≥ -1 for all t"),
        (al.Constraint(Y.mean, lower=0, upper=1, name="both"), (0.0, 1.0), "both", "0 ≤ μ[rms(y)] ≤ 1"),
    ],
)
def test_constraints_say_what_they_bound(constraint, bounds, name, text):
    assert (constraint.lower, constraint.upper) == bounds
    assert constraint.name == name
    assert str(constraint) == text
    assert constraint.is_path is ("for all t" in text)


MODEL = Gain(gain=al.Decision(0.5, 0.0, 10.0), theta=al.Uniform(1.0, half_width=HALF_WIDTH))


def likely(limit):
    return al.Problem(MODEL, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[limit])


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
        ([Y.mean.equals(1)], (2.0, 3.0), [(2.0, 3.0)]),
    ],
)
def test_a_bound_moves_the_side_that_is_closed(constraints, bound, expected):
    moved = problem_with(*constraints).with_bound("response", bound)
    assert [(one.lower, one.upper) for one in moved.constraints] == expected


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


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.Constraint(Y.mean, lower=2.0, upper=1.0), "lower <= upper; received lower=2"),
        (lambda: problem_with(Y.within(0, 1)).with_bound("response", 2.0), r"not symmetric.*\(lower, upper\)"),
        (lambda: gain_problem().with_bound("response", (2.0, 3.0)), r"expected one number.*within\(lower, upper\)"),
        (lambda: gain_problem().with_bound("travel", 1.0), r"no constraint 'travel'; expected one of \['response'\]"),
        (lambda: al.Constraint(Y.mean, lower=-np.inf), "bounds nothing"),
        (lambda: likely(RESPONSE.probability(above=1.0) <= 5), "expected a probability, 0, 1 or from 1e-09"),
        (lambda: likely(1 - RESPONSE.probability(above=1) >= 1 - 1e-12), "expected a probability, 0, 1 or from 1e-09"),
        (lambda: Y <= 5.0, "differs between realisations: take a statistic of it"),
        (lambda: Y.mean < 1.0, "write <= or >="),
        (lambda: bool(Y.mean), "An expression has no truth value"),
        (lambda: Y.equals(1.0), r"expected a statistic of it, such as \.mean\.equals\(1\.0\)"),
        (lambda: 0 <= Y.mean <= 1, "chain such as 'lower <= y <= upper' does not work"),
        (lambda: Y.at_most(1, sigmas=2, worst_case=True), r"expected one of .* received \['sigmas', 'worst_case'\]"),
        (lambda: al.covariance(Y, 1.0), r"A covariance is that of two functionals.*received 1\.0"),
    ],
)
def test_limits_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_bounds_of_probabilities_are_judged_without_factors_and_constants():
    rare = RESPONSE.probability(above=3.0)
    for limit in (al.Constraint(1 - rare, lower=0.999), 1 - rare >= 1 - 1e-9, 0 * rare <= 5):
        assert likely(limit).constraints == (limit,)
    with pytest.raises(al.ProblemError, match="received 5"):
        likely(al.Constraint(100 * rare + 1, upper=501.0))


# --- Statistics of other kinds ---------------------------------------------------------------------------------------


def test_a_sobol_index_of_an_unknown_germ_variable_is_refused_with_a_hint():
    index = LOSS.sobol("theta", "thta")
    problem = gain_problem()
    with pytest.raises(al.ProblemError, match=r"no germ variable 'thta'; expected one of \['theta'\]. Did you mean"):
        al.Problem(problem.system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[index <= 0.5])


@pytest.mark.parametrize(
    ("limit", "width", "printed"),
    cases(
        [
            (
                STRESS.within(-al.value("width"), 4 * al.value("width"), sigmas=3.0),
                np.sqrt((1.0 + 3.0 * SPREAD) / 4.0),
                "μ[stress] − 3 σ[stress] + width ≥ 0 and μ[stress] + 3 σ[stress] − 4 width ≤ 0",
            ),
            (STRESS.within(0.0, al.value("width")), 1.0, "μ[stress] ≥ 0 and μ[stress] − width ≤ 0"),
        ]
    ),
)
def test_a_bound_may_be_a_number_of_the_model(limit, width, printed):
    # The mean stress is 1 / width, its standard deviation SPREAD / width.
    model = bar_problem().system
    problem = al.Problem(model, minimize=MASS.mean, subject_to=[limit])
    assert str(limit) == printed
    assert float(optimum(problem).decisions["width"]) == pytest.approx(width, rel=1e-6)


class Thrown(al.System):
    """A body that is thrown up and lands at an event."""

    states = ("h", "v")
    events: ClassVar = {"ground": al.Event(lambda self, t, z: z.h, direction=-1)}
    speed: al.Number

    def initial(self):
        return {"h": 1.0, "v": self.speed}

    def rhs(self, t, z):
        return z.v, -9.81

    def outputs(self, t, z):
        return {"h": z.h}


def test_the_latest_end_of_a_grid_that_an_event_ends_is_no_final_time():
    grid = al.Grid(until="ground", at_most=10.0, steps=20)
    with pytest.raises(al.ProblemError, match=r"the time of the event is al.at\('ground'\)"):
        al.Problem(Thrown(al.Decision(1.0, 0.1, 3.0)), grid=grid, minimize=al.objectives.final_time())
