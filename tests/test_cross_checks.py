"""Cross-checks: one problem by two transcriptions."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator import crosschecking
from tiny_models import Oscillator, oscillator_problem


def smooth_problem(steps=160):
    """Driven by a smooth force, so that both grids are accurate."""
    force = al.BSpline(np.sin(np.linspace(0.0, 6.0, 9)), degree=3)
    return oscillator_problem(grid=al.Grid(4.0, steps), inputs={"force": force})


@pytest.mark.slow
def test_two_transcriptions_agree_and_say_so():
    found = al.cross_check(smooth_problem())
    assert found.agree, found
    assert found.objective < 1e-6
    assert set(found.statistics) == set(found.first.statistics)
    assert max(found.decisions.values()) < 1e-4
    assert max(found.multipliers.values()) < 1e-2
    assert str(found).startswith("Sequential and Simultaneous (HermiteSimpson) agree to 0.0001")


def test_a_coarse_scheme_does_not_agree_and_what_to_do_is_said():
    with pytest.warns(al.GridWarning):
        found = al.cross_check(smooth_problem(20), second=al.Simultaneous(al.schemes.Trapezoid()), tolerance=1e-6)
    assert not found.agree
    assert "are not both solved, nor agree" in str(found)
    assert "refine=True" in str(found)
    both = replace(found, second=replace(found.second, status=al.Status.SOLVED))
    assert "do NOT agree" in str(both)
    assert "Refine both grids" in str(both)


def test_differences_are_relative_and_a_failed_solution_never_agrees():
    found = al.cross_check(smooth_problem())
    failed = replace(found, second=replace(found.second, status=al.Status.FAILED))
    assert not failed.agree
    expected = abs(found.first.objective - found.second.objective) / max(found.first.objective, found.second.objective)
    assert found.objective == pytest.approx(expected)
    change = np.abs(found.first.vector - found.second.vector) / (8.0 - 0.05)  # the range of the damper
    assert found.decisions == pytest.approx({"c": change[0]})


class Pendulum(al.System):
    states = ("angle", "rate")

    def rhs(self, t, z, push):
        return z.rate, push - 9.81 * jnp.sin(z.angle)

    def outputs(self, t, z, push):
        return {"angle": z.angle, "rate": z.rate, "effort": push**2}


def test_controls_that_follow_a_finer_mesh_are_not_compared():
    problem = al.Problem(
        Pendulum(),
        grid=al.Grid(1.0, 8),
        inputs={"push": al.Control(0.0, -20.0, 20.0, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("angle").mean.equals(1.0), al.terminal("rate").mean.equals(0.0)],
    )
    found = al.cross_check(problem, second=al.Simultaneous(error=1e-7), tolerance=1e-2)
    assert found.second.decisions["inputs.push"].size > found.first.decisions["inputs.push"].size
    assert found.decisions == {"inputs.push": np.inf}
    assert found.objective < 1e-2


class Decay(al.System):
    states = ("x",)
    k: al.Number = 1.0

    def rhs(self, t, z):
        return (-self.k * z.x,)

    def outputs(self, t, z):
        return {"x": z.x, "zero": 0.0 * z.x}

    def initial(self):
        return {"x": 1.0}


def decay(minimize, *limits, steps=10, most=3.0):
    rate = al.Decision(1.0, 0.1, most)
    return al.Problem(Decay(rate), grid=al.Grid(1.0, steps), minimize=minimize, subject_to=list(limits))


def test_a_distance_that_becomes_zero_is_judged_by_what_it_is_made_of():
    problem = decay((al.terminal("x").mean - 0.25) ** 2 + (al.value("k") - np.log(4.0)) ** 2)
    found = al.cross_check(problem)
    assert max(found.first.objective, found.second.objective) < 1e-9
    assert found.agree, found
    off = replace(found.second, objective=1e-3)
    again = crosschecking._difference(found.first.objective, off.objective, crosschecking._objective_size(off))
    assert again > found.tolerance


def test_paths_on_different_grids_are_compared_at_the_instants_that_both_have():
    found = al.cross_check(decay(-al.value("k"), al.path("x").mean >= 0.01, steps=3, most=30.0), refine=True)
    assert found.first.instants.size != found.second.instants.size
    assert found.agree, found
    assert found.first.decisions["k"] == pytest.approx(-np.log(0.01), rel=1e-5)


def test_prices_of_limits_that_do_not_act_are_equal():
    assert al.cross_check(decay(al.value("k"), al.terminal("x").mean >= 0.3)).multipliers == pytest.approx(
        {"μ[x(t_f)] ≥ 0.3": 0.0}, abs=1e-4
    )


def test_other_decisions_of_a_flat_optimum_are_no_fault_of_the_grids():
    said = str(al.cross_check(decay(al.terminal("zero").mean, al.terminal("x").mean <= 0.3)))
    assert "several optima, or a flat one" in said
    assert "Refine" not in said


def test_each_way_that_finds_no_solution_says_why():
    said = str(al.cross_check(decay(al.value("k"), al.terminal("x").mean <= 0.01)))
    assert "are not both solved" in said
    assert said.count("'x' is violated by") == 2
    assert "Refine" not in said


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"solvers": (None,)}, "solvers"),
        ({"second": "simultaneous"}, "second"),
        ({"first": None}, "first"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_what_is_no_transcription_or_tolerance_is_refused(given, word):
    with pytest.raises(al.ProblemError, match=f"cross_check: {word}"):
        al.cross_check(smooth_problem(), **given)


def test_what_is_no_problem_is_refused():
    with pytest.raises(al.ProblemError, match="cross_check: problem"):
        al.cross_check(Oscillator(m=1.0, c=1.0, k=1.0))


@pytest.mark.slow
def test_two_ways_of_one_kind_are_told_apart():
    problem = smooth_problem()
    schemes = (al.schemes.Radau(2), al.schemes.GaussLegendre(2))
    found = al.cross_check(problem, first=al.Simultaneous(schemes[0]), second=al.Simultaneous(schemes[1]))
    assert found.ways == ("Simultaneous (Radau(2))", "Simultaneous (GaussLegendre(2))")
    found = al.cross_check(problem, second=al.Sequential(), solvers=(None, al.solvers.Slsqp()))
    assert len(set(found.ways)) == 2
    assert "SLSQP" in found.ways[1]
