"""What is warned of within a sweep names the point that it speaks of."""

import contextlib
import warnings

import pytest

import aleator as al
from aleator._core.warned import warned_of
from zoo import Decay


def decay():
    """A decay on a grid that is too coarse for a thousandth of the spread."""
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.2, 0.5, 4.0), half_width=0.1)),
        grid=al.Grid(1.0, 3),
        minimize=al.value("rate.mean"),
        subject_to=[al.terminal("x").at_most(0.4, sigmas=1.0)],
    )


def places(work):
    """Of what is warned of by us, the points."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        work()
    said = [str(one.message) for one in heard if issubclass(one.category, al.AleatorWarning)]
    return [one.partition(" is off")[0] for one in said if "is off" in one]


def test_sweeps_name_the_point_that_they_warn_of():
    coarse = "On 3 steps 'x(t_f)'"
    assert places(lambda: al.pareto(decay(), "x", [0.4])) == [f"pareto, at x = 0.4: {coarse}"]
    assert places(lambda: al.multistart(decay(), [{"rate.mean": 1.0}])) == [f"multistart, from start 1: {coarse}"]
    trials = places(lambda: al.calibrate(decay(), "x", 0.1, samples=200, max_trials=2))
    assert len(trials) == 2
    assert trials[0] == f"calibrate, at sigmas = 1: {coarse}"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(al.GridWarning, match=r"pareto, at x = 0\.4: On 3 steps"):
            al.pareto(decay(), "x", [0.4])


def test_a_warning_points_at_the_line_that_called_the_package_and_a_library_keeps_its_own():
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        with contextlib.suppress(ValueError), warned_of("here"):
            warnings.warn_explicit("ours", al.GridWarning, "deep inside", 1)
            warnings.warn_explicit("theirs", RuntimeWarning, "a library", 2)
            raise ValueError("after what was warned of")
    assert [(str(one.message), one.category, one.filename) for one in heard] == [
        ("here: ours", al.GridWarning, __file__),
        ("theirs", RuntimeWarning, "a library"),
    ]
