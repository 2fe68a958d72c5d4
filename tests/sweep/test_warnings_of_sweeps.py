"""What is warned of within a sweep names the point that it speaks of."""

import contextlib
import warnings

import pytest

import aleator as al
from aleator._core.warned import warned_of
from aleator.sweep import _each as each_module
from zoo import bar_problem


def test_sweeps_name_the_point_that_they_warn_of(monkeypatch):
    def rough(*arguments, **options):
        warnings.warn("rough", al.GridWarning, stacklevel=1)
        return al.solve(*arguments, **options)

    monkeypatch.setattr(each_module, "solve", rough)
    with pytest.warns(al.GridWarning) as heard:
        al.pareto(bar_problem(), "stress", [0.5, 0.4])
    assert [str(one.message) for one in heard] == [f"pareto, at stress = {bound}: rough" for bound in (0.5, 0.4)]
    with pytest.warns(al.GridWarning, match="^multistart, from start 1: rough$"):
        al.multistart(bar_problem(), 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(al.GridWarning, match=r"pareto, at stress = 0\.5: rough"):
            al.pareto(bar_problem(), "stress", [0.5])


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
