"""Cross-checks: one problem by two transcriptions."""

from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from zoo import Decay


def decay(most=0.4):
    """The slowest decay to `most` within a second, of a uniform rate."""
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.2, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("rate.mean"),
        subject_to=[al.terminal("x").at_most(most, sigmas=1.0).named("level")],
    )


@pytest.fixture(scope="module")
def both():
    return al.cross_check(decay())


def test_two_transcriptions_agree_and_say_so(both):
    assert both.agree, both
    assert both.objective < 1e-6
    assert set(both.statistics) == set(both.first.statistics)
    assert max(both.decisions.values()) < 1e-4
    assert max(both.multipliers.values()) < 1e-2
    assert str(both).startswith("Sequential and Simultaneous (HermiteSimpson) agree to 0.0001")
    objectives = both.first.objective, both.second.objective
    assert both.objective == pytest.approx(abs(np.subtract(*objectives)) / max(objectives))
    change = np.abs(both.first.vector - both.second.vector) / (2.0 - 0.5)  # the range of the rate
    assert both.decisions == pytest.approx({"rate.mean": change[0]})


def test_what_is_not_solved_or_differs_does_not_agree_and_what_to_do_is_said(both):
    failed = replace(both, second=replace(both.second, status=al.Status.FAILED))
    assert not failed.agree
    assert "are not both solved, nor agree" in str(failed)
    apart = replace(both, objective=2e-4)
    assert not apart.agree
    assert "Refine both grids (refine=True" in str(apart)
    flat = replace(both, decisions={"rate.mean": 0.1}, statistics={"x": 2e-4})
    assert not flat.agree
    assert "Both reach the same objective, by other values of rate.mean" in str(flat)
