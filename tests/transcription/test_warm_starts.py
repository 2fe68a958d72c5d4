"""Solutions as starts of problems with other trajectories, other grids and other bounds."""

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


def problem(force, *, t_final=1.0, steps=12, mass=1.0):
    """Bryson and Denham's: there and back within a second, but no farther than `HIGHEST`."""
    return al.Problem(
        Launched(mass=mass, speed=1.0),
        grid=al.Grid(t_final, steps),
        inputs={"force": force},
        minimize=0.5 * al.integral("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.0),
            al.terminal("v").mean.equals(-1.0),
            al.path("x").at_most(HIGHEST),
        ],
    )


def spline(points, limits=200.0, **options):
    return al.BSpline(al.Decision(np.asarray(points, dtype=float), -limits, limits), **options)


RANDOM = np.random.default_rng(5).normal(size=9)
TIMES = np.linspace(0.0, 1.0, 41)


@pytest.fixture(scope="module")
def solution():
    """Any solution, which others are made of."""
    return al.solve(bar_problem())


@pytest.fixture(scope="module")
def begun(solution):
    """The curves at the start of problems from those of others, both over the fraction of time."""

    def all_of(*cases):
        vectors = [np.asarray(vector, dtype=float) for _, vector, _ in cases]
        starts = [
            started_from(new, replace(solution, problem=old, vector=vector))
            for (old, _, new), vector in zip(cases, vectors, strict=True)
        ]

        def curve(declared, vector):
            model = realise(declared.simulation, np.zeros(0), vector)
            return model.inputs["force"].sampled(TIMES, 0.0, model.grid.t_final)

        @compiled
        def curves(vectors, starts):
            each = zip(cases, vectors, starts, strict=True)
            return [(curve(old, vector), curve(new, start)) for (old, _, new), vector, start in each]

        return [(np.asarray(before), np.asarray(after)) for before, after in curves(vectors, starts)]

    return all_of


def test_a_spline_whose_knots_contain_the_old_ones_begins_as_the_same_curve(begun):
    finer = (
        spline(np.zeros(15)),  # twice as many knots
        spline(np.zeros(10), knots=[1 / 6, 0.25, 1 / 3, 0.5, 2 / 3, 5 / 6]),  # one knot more
    )
    old = problem(spline(RANDOM))
    for before, after in begun(*((old, RANDOM, problem(new, t_final=2.0, steps=30)) for new in finer)):
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-11 * np.abs(before).max())


def test_ends_and_another_degree_keep_the_curve_where_they_allow_it(begun):
    # A parabola that starts on the move: exact in splines of any degree from two on, whatever the duration.
    t_final = 2.0
    parabola = problem(al.PowerSeries(start=(0.5, -1.0 / t_final), end=al.Decision(0.0, -9, 9)), t_final=t_final)
    ends = {"start": (0.5, -1.0 / t_final)}
    other = problem(spline(np.zeros(7), degree=4, **ends), t_final=t_final)
    ((before, after),) = begun((parabola, [0.7], other))
    np.testing.assert_allclose(before, 0.5 - TIMES + 1.2 * TIMES**2, rtol=1e-12)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)


def test_a_coarser_spline_comes_as_close_as_least_squares_does(begun):
    ((before, after),) = begun((problem(spline(RANDOM)), RANDOM, problem(spline(np.zeros(5)))))
    many = np.linspace(0.0, 1.0, 4001)
    exact = BSpline(np.r_[[0.0] * 4, np.arange(1, 6) / 6, [1.0] * 4], RANDOM, 3)(many)
    closest = make_lsq_spline(many, exact, [0.0] * 4 + [0.5] + [1.0] * 4, 3)
    np.testing.assert_allclose(before, exact[::100], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after, closest(TIMES), rtol=0, atol=2e-3 * np.abs(before).max())


def test_a_start_lies_within_the_bounds_and_on_other_nodes_a_control_is_the_same_function(solution):
    old = problem(spline(np.zeros(5), degree=1))
    known = replace(solution, problem=old, vector=np.array([0.1, 1, 0.2, 0.1, -3]))
    found = started_from(problem(spline(np.zeros(9), limits=0.25, degree=1)), known)
    np.testing.assert_allclose(found, [0.1, 0.25, 0.25, 0.25, 0.2, 0.15, 0.1, -0.25, -0.25], rtol=1e-12)
    coarse, fine = (problem(al.Control(0.0), steps=steps) for steps in (4, 8))
    levels = replace(solution, problem=coarse, vector=RANDOM[:4])
    np.testing.assert_allclose(started_from(fine, levels), np.repeat(RANDOM[:4], 2))


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
