"""Solutions as starts of problems with other trajectories and other grids."""

from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator.transcription import started_from
from aleator.uncertainty import realise
from compiling import compiled
from zoo import Launched, bar_problem

HIGHEST = 1 / 9


def problem(force, *, t_final=1.0, steps=12):
    """Bryson and Denham's: there and back within a second, but no farther than `HIGHEST`."""
    return al.Problem(
        Launched(speed=1.0),
        grid=al.Grid(t_final, steps),
        inputs={"force": force},
        minimize=0.5 * al.integral("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.0),
            al.terminal("v").mean.equals(-1.0),
            al.path("x").at_most(HIGHEST),
        ],
    )


def spline(points, **options):
    return al.BSpline(al.Decision(np.asarray(points, dtype=float), -200.0, 200.0), **options)


RANDOM = np.random.default_rng(5).normal(size=9)
TIMES = np.linspace(0.0, 1.0, 41)


@pytest.fixture(scope="module")
def begun():
    """The curves of a problem and at the start of another one from it, both over the fraction of time."""
    solution = al.solve(bar_problem())  # any one, of which others are made

    def curve(declared, vector):
        def sampled(vector):
            model = realise(declared.simulation, np.zeros(0), vector)
            return model.inputs["force"].sampled(TIMES, 0.0, model.grid.t_final)

        return np.asarray(compiled(sampled)(vector))

    def both(old, vector, new):
        return curve(old, vector), curve(new, started_from(new, replace(solution, problem=old, vector=vector)))

    return both


def test_a_spline_whose_knots_contain_the_old_ones_begins_as_the_same_curve(begun):
    finer = problem(spline(np.zeros(15)), t_final=2.0, steps=30)
    before, after = begun(problem(spline(RANDOM)), RANDOM, finer)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-11 * np.abs(before).max())
