"""Solutions as starts of problems with other trajectories and other grids."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_lsq_spline

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


@pytest.mark.slow
def test_a_coarser_spline_comes_as_close_as_least_squares_does(begun):
    before, after = begun(problem(spline(RANDOM)), RANDOM, problem(spline(np.zeros(5))))
    many = np.linspace(0.0, 1.0, 4001)
    exact = BSpline(np.r_[[0.0] * 4, np.arange(1, 6) / 6, [1.0] * 4], RANDOM, 3)(many)
    closest = make_lsq_spline(many, exact, [0.0] * 4 + [0.5] + [1.0] * 4, 3)
    np.testing.assert_allclose(before, exact[::100], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after, closest(TIMES), rtol=0, atol=2e-3 * np.abs(before).max())


@pytest.mark.slow
def test_from_coarse_to_fine_the_optimum_of_the_closed_form_is_reached():
    # With the way limited to h, the least effort is 4 / (9 h), by straight lines whose corners are at 3 h and 1 - 3 h:
    # between the knots of the coarse spline, on those of the fine one.
    coarse = al.solve(problem(spline(np.zeros(5), degree=1)), between=1)
    exact = 4 / (9 * HIGHEST)
    assert coarse.objective > 1.005 * exact
    fine = al.solve(problem(spline(np.zeros(13), degree=1), steps=24), warm_start=coarse, between=1)
    assert fine.objective == pytest.approx(exact, rel=1e-6)
    knots = np.linspace(0.0, 1.0, 13)
    expected = -2 / (3 * HIGHEST) * np.maximum(0.0, np.maximum(1 - knots / (3 * HIGHEST), 1 - (1 - knots) * 3))
    np.testing.assert_allclose(fine.decisions["inputs.force.free"], expected, rtol=0, atol=1e-3)
