"""Cross-checks: one problem by two transcriptions."""

from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator.sweep import _cross_check
from zoo import Decay


def decay(most=0.4, steps=20):
    """The slowest decay to `most` within a second, of a uniform rate."""
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.2, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, steps),
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


def test_prices_of_limits_that_do_not_act_are_equal_and_progress_tells_each_solve():
    told = []
    found = al.cross_check(decay(most=0.9), progress=lambda *words: told.append(words))
    assert list(found.multipliers.values()) == [pytest.approx(0.0, abs=1e-4)]
    assert told == [("cross-check", done, 2) for done in (0, 1, 2)]


def test_a_program_beyond_the_budget_is_refused_before_anything_is_solved():
    problem, told = decay(steps=20), []
    points = al.solve(problem).certificate.expansion.points
    # Hermite and Simpson's scheme has the state at both ends of each step, and in its middle.
    size = points * (2 * 20 + 1)
    assert al.Simultaneous().count(problem) == size
    with pytest.raises(al.ProblemError, match=rf"{size} states would be variables, more than the {size - 1} of"):
        al.cross_check(problem, most_states=size - 1, progress=lambda *words: told.append(words))
    assert told == []


def test_ctrl_c_after_the_first_solve_is_itself():
    def stop(task, done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        al.cross_check(decay(most=0.9), progress=stop)


@pytest.mark.slow
def test_a_distance_that_becomes_zero_is_judged_by_what_it_is_made_of():
    distance = (al.terminal("x").mean - 0.25) ** 2 + (al.value("rate") - np.log(4.0)) ** 2
    problem = al.Problem(Decay(al.Decision(1.0, 0.1, 3.0)), grid=al.Grid(1.0, 10), minimize=distance)
    near = al.cross_check(problem)
    assert max(near.first.objective, near.second.objective) < 1e-9
    assert near.agree, near
    off = replace(near.second, objective=1e-3)
    again = _cross_check._difference(near.first.objective, off.objective, _cross_check._objective_size(off))
    assert again > near.tolerance
