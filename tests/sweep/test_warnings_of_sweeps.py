"""What is warned of within a sweep names the point that it speaks of; what cannot be told of progress is refused."""

import contextlib
import warnings

import pytest

import aleator as al
from aleator._core.warned import warned_of
from tiny_models import Decay

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


def test_the_grid_is_coarse_for_one_problem_as_it_is():
    said = told(lambda: al.solve(decay()))
    assert [one.partition(" is off")[0] for one in said] == ["On 3 steps 'x(t_f)'"]


def test_a_front_names_the_value_of_its_bound():
    said = told(lambda: al.pareto(decay(), "x", [0.4, 0.35]))
    assert [one.partition(" is off")[0] for one in said] == [
        "pareto, at x = 0.4: On 3 steps 'x(t_f)'",
        "pareto, at x = 0.35: On 3 steps 'x(t_f)'",
    ]


def test_a_search_names_its_start():
    said = told(lambda: al.multistart(decay(), [{"rate.mean": 1.0}, {"rate.mean": 3.0}]))
    assert [one.partition(" is off")[0] for one in said] == [
        "multistart, from start 1: On 3 steps 'x(t_f)'",
        "multistart, from start 2: On 3 steps 'x(t_f)'",
    ]


def test_a_calibration_names_its_margin():
    said = told(lambda: al.calibrate(decay(), "x", 0.1, samples=500, max_trials=2))
    found = [one for one in said if "is off" in one]
    assert len(found) == 2
    assert found[0].startswith("calibrate, at sigmas = 1: On 3 steps 'x(t_f)'")
    assert all(one.startswith("calibrate, at sigmas = ") for one in found)


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


@pytest.fixture(scope="module")
def solution():
    return al.solve(decay(50))


CALLS = {
    "pareto": lambda progress, _: al.pareto(decay(), "x", [0.4], progress=progress),
    "multistart": lambda progress, _: al.multistart(decay(), 2, progress=progress),
    "calibrate": lambda progress, _: al.calibrate(decay(), "x", progress=progress),
    "validate": lambda progress, solution: al.validate(solution, 10, progress=progress),
    "rare_violation": lambda progress, solution: al.rare_violation(solution, progress=progress),
    "monte_carlo": lambda progress, _: al.references.monte_carlo(len, RATE, progress=progress),
    "quasi_monte_carlo": lambda progress, _: al.references.quasi_monte_carlo(len, RATE, progress=progress),
    "sobol_indices": lambda progress, _: al.references.sobol_indices(len, RATE, progress=progress),
}


@pytest.mark.parametrize("progress", [3, None, True, "bar", lambda task: None], ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("name", CALLS)
def test_what_is_no_progress_is_refused_before_any_work(name, progress, solution):
    with pytest.raises(al.ProblemError, match=f"^{name}: progress: expected a function of three arguments.*received"):
        CALLS[name](progress, solution)
