"""Cross-checks: one problem by two transcriptions, and the chapter of a study that shows both answers."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator import crosschecking
from aleator.journalling import recalling
from aleator.studies._second_way import collocated, found_both_ways, second_way
from zoo import Decay, oscillator_problem


def decay(most=0.4):
    """The slowest decay to `most` within a second, of a uniform rate."""
    return al.Problem(
        Decay(al.Uniform(al.Decision(1.2, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("rate.mean"),
        subject_to=[al.terminal("x").at_most(most, sigmas=1.0).named("level")],
    )


def both_ways():
    said = []
    both = found_both_ways("dOpt", decay(), lambda *told: said.append(told))
    assert said[0][0] == "dOpt by direct collocation"
    return both


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("journal")


@pytest.fixture(scope="module")
def both(folder):
    with al.journal(folder):
        return both_ways()


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
    assert "do NOT agree" in str(apart)
    assert "Refine both grids (refine=True" in str(apart)
    assert not replace(both, statistics={"x": 2e-4}).agree
    flat = replace(both, decisions={"rate.mean": 0.1}, statistics={"x": 2e-4})
    assert "Both reach the same objective, by other values of rate.mean" in str(flat)


def test_prices_of_limits_that_do_not_act_are_equal():
    assert list(al.cross_check(decay(most=0.9)).multipliers.values()) == [pytest.approx(0.0, abs=1e-4)]


def test_controls_on_meshes_of_their_own_are_not_compared_and_paths_at_common_instants():
    force = al.Decision(np.zeros(3), -1.0, 1.0)
    assert crosschecking._decided(force, np.zeros(3), np.zeros(5)) == math.inf
    assert crosschecking._decided(force, np.zeros(3), np.array([0.0, 0.5, 0.0])) == 0.25


class Swing(al.System):
    """A pendulum that a torque pushes, whose controls a mesh follows."""

    states = ("angle", "rate")

    def rhs(self, t, z, push):
        return z.rate, push - 9.81 * jnp.sin(z.angle)

    def outputs(self, t, z, push):
        return {"angle": z.angle, "rate": z.rate, "effort": push**2}


@pytest.mark.slow
def test_controls_that_follow_a_finer_mesh_and_paths_on_other_grids_are_compared_where_they_can_be():
    swung = al.Problem(
        Swing(),
        grid=al.Grid(1.0, 8),
        inputs={"push": al.Control(0.0, -20.0, 20.0, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("angle").mean.equals(1.0), al.terminal("rate").mean.equals(0.0)],
    )
    by_mesh = al.cross_check(swung, second=al.Simultaneous(error=1e-7), tolerance=1e-2)
    assert by_mesh.second.decisions["inputs.push"].size > by_mesh.first.decisions["inputs.push"].size
    assert by_mesh.decisions["inputs.push"] == math.inf
    rate = al.Decision(1.0, 0.1, 30.0)
    limit = al.path("x").mean >= 0.01
    problem = al.Problem(Decay(rate), grid=al.Grid(1.0, 3), minimize=-al.value("rate"), subject_to=[limit])
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


def test_two_ways_of_one_kind_are_told_apart():
    by_another = al.cross_check(decay(), second=al.Sequential(), solvers=(None, al.solvers.Slsqp()))
    assert len(set(by_another.ways)) == 2
    assert "SLSQP" in by_another.ways[1]


@pytest.mark.slow
def test_schemes_are_told_apart_and_a_coarse_one_does_not_agree():
    found = al.cross_check(
        decay(), first=al.Simultaneous(al.schemes.Radau(2)), second=al.Simultaneous(al.schemes.GaussLegendre(2))
    )
    assert found.ways == ("Simultaneous (Radau(2))", "Simultaneous (GaussLegendre(2))")
    coarse = decay().on_grid(al.Grid(1.0, 2))
    with pytest.warns(al.GridWarning):
        found = al.cross_check(coarse, second=al.Simultaneous(al.schemes.Trapezoid()), tolerance=1e-6)
    assert not found.agree


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"second": "simultaneous"}, "second"),
        ({"first": None}, "first"),
        ({"solvers": (None,)}, "solvers"),
        ({"problem": Decay(1.0)}, "problem"),
    ],
)
def test_what_is_no_problem_or_transcription_is_refused(options, word):
    with pytest.raises(al.ProblemError, match=f"cross_check: {word}"):
        al.cross_check(**{"problem": decay(), **options})


# --- The chapter of a study ------------------------------------------------------------------------------------------


def read(text):
    """The number of a text such as `4.1·10⁻¹⁰`."""
    mantissa, _, power = text.partition("·10")
    return float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)


def rows(both):
    table, mesh = second_way("dOpt", both).blocks
    assert mesh.kind == "drawing"
    return table.caption, {row[0]: row[1:] for row in table.rows}


def test_nothing_is_shown_before_it_is_computed():
    assert second_way("dOpt", None).blocks == []
    assert collocated("dOpt", None) == {}


def test_both_answers_stand_side_by_side_with_their_difference(both):
    caption, shown = rows(both)
    assert caption == "dOpt by shooting and by direct collocation: they agree to 0.0001"
    first, second, difference = shown["rate.mean"]
    assert float(first) == pytest.approx(float(both.first.decisions["rate.mean"]), rel=1e-7)
    assert float(second) == pytest.approx(float(both.second.decisions["rate.mean"]), rel=1e-7)
    assert read(difference) == pytest.approx(both.decisions["rate.mean"], rel=0.06)
    worst = max(both.statistics, key=both.statistics.__getitem__)
    assert worst in shown["Statistics, the largest difference"][2]
    assert shown["Iterations"][:2] == [str(one.effort.iterations) for one in (both.first, both.second)]
    assert collocated("dOpt", both) == {"dOpt": both.second}


def test_what_does_not_agree_cannot_be_compared_or_is_at_its_bound_is_said_or_left_out(both):
    caption, shown = rows(replace(both, objective=0.1, decisions={"rate.mean": math.inf}))
    assert "do NOT agree" in caption
    assert shown["rate.mean"][2] == "on another mesh"
    fixed = replace(both, first=replace(both.first, at_bounds=("rate.mean",)))
    assert "rate.mean" not in rows(fixed)[1]


def test_both_answers_are_taken_from_their_journal(both, folder):
    with recalling(folder):
        again = both_ways()
    assert again.objective == both.objective
    assert again.statistics == both.statistics
    assert again.second.vector.tobytes() == both.second.vector.tobytes()


@pytest.mark.slow
def test_two_transcriptions_agree_on_a_path_near_resonance():
    assert al.cross_check(oscillator_problem()).agree
