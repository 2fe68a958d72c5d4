"""What is warned of within a sweep names the point that it speaks of; what cannot be told of progress is refused."""

import contextlib
import warnings

import pytest

import aleator as al
from aleator._core.warned import warned_of
from zoo import Decay, bar_problem

RATE = {"rate": al.Uniform(1.0, half_width=0.1)}


def decay(steps=3):
    """A decay on a grid that is too coarse for a thousandth of the spread."""
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.2, 0.5, 4.0), half_width=0.1)),
        grid=al.Grid(1.0, steps),
        minimize=al.value("rate.mean"),
        subject_to=[al.terminal("x").at_most(0.4, sigmas=1.0)],
    )


def told(work):
    """What is warned of, by us."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        work()
    return [str(one.message) for one in heard if issubclass(one.category, al.AleatorWarning)]


def places(said):
    return [one.partition(" is off")[0] for one in said if "is off" in one]


def test_sweeps_name_the_point_that_they_warn_of():
    coarse = "On 3 steps 'x(t_f)'"
    assert places(told(lambda: al.solve(decay()))) == [coarse]
    front = told(lambda: al.pareto(decay(), "x", [0.4, 0.35]))
    assert places(front) == [f"pareto, at x = 0.4: {coarse}", f"pareto, at x = 0.35: {coarse}"]
    starts = told(lambda: al.multistart(decay(), [{"rate.mean": 1.0}, {"rate.mean": 3.0}]))
    assert places(starts) == [f"multistart, from start 1: {coarse}", f"multistart, from start 2: {coarse}"]
    trials = places(told(lambda: al.calibrate(decay(), "x", 0.1, samples=500, max_trials=2)))
    assert len(trials) == 2
    assert trials[0] == f"calibrate, at sigmas = 1: {coarse}"
    assert trials[1].startswith("calibrate, at sigmas = ")


def test_a_warning_points_at_the_line_that_called_the_package_and_a_library_keeps_its_own():
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        with warned_of("here"):
            warnings.warn_explicit("ours", al.GridWarning, "deep inside", 1)
            warnings.warn_explicit("theirs", RuntimeWarning, "a library", 2)
    assert [(str(one.message), one.category, one.filename) for one in heard] == [
        ("here: ours", al.GridWarning, __file__),
        ("theirs", RuntimeWarning, "a library"),
    ]


def test_what_was_warned_of_before_an_error_is_told():
    def fails():
        with contextlib.suppress(ValueError), warned_of("here"):
            warnings.warn("early", al.GridWarning, stacklevel=1)
            raise ValueError("late")

    assert told(fails) == ["here: early"]


def test_warnings_that_are_errors_are_raised_with_the_point():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(al.GridWarning, match=r"pareto, at x = 0\.4: On 3 steps"):
            al.pareto(decay(), "x", [0.4, 0.35])


CALLS = {
    "pareto": lambda progress: al.pareto(bar_problem(), "stress", [0.4], progress=progress),
    "multistart": lambda progress: al.multistart(bar_problem(), 2, progress=progress),
    "calibrate": lambda progress: al.calibrate(bar_problem(), "stress", progress=progress),
    "conflict": lambda progress: al.conflict(bar_problem(), progress=progress),
    "portfolio": lambda progress: al.portfolio(bar_problem(), 2, progress=progress),
    "validate": lambda progress: al.validate(al.solve(bar_problem()), 10, progress=progress),
    "rare_violation": lambda progress: al.rare_violation(al.solve(bar_problem()), progress=progress),
    "monte_carlo": lambda progress: al.references.monte_carlo(len, RATE, progress=progress),
    "quasi_monte_carlo": lambda progress: al.references.quasi_monte_carlo(len, RATE, progress=progress),
    "sobol_indices": lambda progress: al.references.sobol_indices(len, RATE, progress=progress),
}


@pytest.mark.parametrize("name", CALLS)
def test_what_is_no_progress_is_refused_before_any_work(name):
    for progress in (3, None, lambda task: None):
        with pytest.raises(al.ProblemError, match=f"^{name}: progress: expected a function of three arguments"):
            CALLS[name](progress)
