"""Cross-checks: one problem by two transcriptions, and the chapter of a study that shows both answers."""

import math
from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator import crosschecking
from aleator.studies._second_way import collocated, found_both_ways, second_way
from zoo import Decay, Oscillator


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
    return found_both_ways("dOpt", decay(), lambda *told: None)


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


def test_prices_of_limits_that_do_not_act_are_equal():
    assert list(al.cross_check(decay(most=0.9)).multipliers.values()) == [pytest.approx(0.0, abs=1e-4)]


@pytest.mark.slow
def test_controls_that_follow_a_finer_mesh_and_paths_on_other_grids_are_compared_where_they_can_be():
    pushed = al.Problem(
        Oscillator(m=1.0, c=0.5, k=30.0),
        grid=al.Grid(1.0, 8),
        inputs={"force": al.Control(0.0, -20.0, 20.0, degree=1)},
        minimize=al.rms("v").mean,
        subject_to=[al.terminal("x").mean.equals(0.2)],
    )
    by_mesh = al.cross_check(pushed, second=al.Simultaneous(error=1e-7), tolerance=1e-2)
    assert by_mesh.second.decisions["inputs.force"].size > by_mesh.first.decisions["inputs.force"].size
    assert by_mesh.decisions["inputs.force"] == math.inf
    limit = al.path("x").mean >= 0.01
    system = Decay(al.Decision(1.0, 0.1, 30.0))
    problem = al.Problem(system, grid=al.Grid(1.0, 3), minimize=-al.value("rate"), subject_to=[limit])
    refined = al.cross_check(problem, refine=True)
    assert refined.first.instants.size != refined.second.instants.size
    assert refined.agree, refined
    assert refined.first.decisions["rate"] == pytest.approx(-np.log(0.01), rel=1e-5)


def test_a_distance_that_becomes_zero_is_judged_by_what_it_is_made_of():
    distance = (al.terminal("x").mean - 0.25) ** 2 + (al.value("rate") - np.log(4.0)) ** 2
    problem = al.Problem(Decay(al.Decision(1.0, 0.1, 3.0)), grid=al.Grid(1.0, 10), minimize=distance)
    near = al.cross_check(problem)
    assert max(near.first.objective, near.second.objective) < 1e-9
    assert near.agree, near
    off = replace(near.second, objective=1e-3)
    again = crosschecking._difference(near.first.objective, off.objective, crosschecking._objective_size(off))
    assert again > near.tolerance


# --- The chapter of a study ------------------------------------------------------------------------------------------


def rows(both):
    table, mesh = second_way("dOpt", both).blocks
    assert mesh.kind == "drawing"
    return table.caption, {row[0]: row[1:] for row in table.rows}


def test_both_answers_stand_side_by_side_with_their_difference(both):
    caption, shown = rows(both)
    assert caption == "dOpt by shooting and by direct collocation: they agree to 0.0001"
    first, second, _ = shown["rate.mean"]
    assert float(first) == pytest.approx(float(both.first.decisions["rate.mean"]), rel=1e-7)
    assert float(second) == pytest.approx(float(both.second.decisions["rate.mean"]), rel=1e-7)
    worst = max(both.statistics, key=both.statistics.__getitem__)
    assert worst in shown["Statistics, the largest difference"][2]
    assert collocated("dOpt", both) == {"dOpt": both.second}
    assert second_way("dOpt", None).blocks == []


def test_what_does_not_agree_cannot_be_compared_or_is_at_its_bound_is_said_or_left_out(both):
    caption, shown = rows(replace(both, objective=0.1, decisions={"rate.mean": math.inf}))
    assert "do NOT agree" in caption
    assert shown["rate.mean"][2] == "on another mesh"
    fixed = replace(both, first=replace(both.first, at_bounds=("rate.mean",)))
    assert "rate.mean" not in rows(fixed)[1]
