"""Cross-checks: one problem by two transcriptions."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from tiny_models import Oscillator, oscillator_problem


def smooth_problem(steps=160):
    """Driven by a smooth force, so that both grids are accurate."""
    force = al.BSpline(np.sin(np.linspace(0.0, 6.0, 9)), degree=3)
    return oscillator_problem(grid=al.Grid(4.0, steps), inputs={"force": force})


def test_two_transcriptions_agree_and_say_so():
    found = al.cross_check(smooth_problem())
    assert found.agree, found
    assert found.objective < 1e-6
    assert set(found.statistics) == set(found.first.statistics)
    assert max(found.decisions.values()) < 1e-4
    assert max(found.multipliers.values()) < 1e-2
    assert str(found).startswith("Sequential and Simultaneous agree to 0.0001")


def test_a_coarse_scheme_does_not_agree_and_what_to_do_is_said():
    with pytest.warns(al.GridWarning):
        found = al.cross_check(smooth_problem(20), second=al.Simultaneous(al.schemes.Trapezoid()), tolerance=1e-6)
    assert not found.agree
    assert "do NOT agree" in str(found)
    assert "Refine both grids" in str(found)


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


@pytest.mark.parametrize(
    ("given", "word"),
    [({"second": "simultaneous"}, "second"), ({"first": None}, "first"), ({"tolerance": 0.0}, "tolerance")],
)
def test_what_is_no_transcription_or_tolerance_is_refused(given, word):
    with pytest.raises(al.ProblemError, match=f"cross_check: {word}"):
        al.cross_check(smooth_problem(), **given)


def test_what_is_no_problem_is_refused():
    with pytest.raises(al.ProblemError, match="cross_check: problem"):
        al.cross_check(Oscillator(m=1.0, c=1.0, k=1.0))
