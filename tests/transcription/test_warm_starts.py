"""Solutions as starts of problems with other trajectories, other grids and other bounds."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline, make_lsq_spline

import aleator as al
from aleator.transcription import started_from
from aleator.uncertainty import realise

HIGHEST = 1 / 9


class Cart(al.System):
    """A double integrator, and the effort that it takes (Bryson and Denham's problem is made of it)."""

    states = ("x", "v", "effort")
    gain: al.Number = 1.0

    def initial(self):
        return {"v": 1.0}

    def rhs(self, t, z, u):
        return z.v, self.gain * jnp.sum(u), 0.5 * jnp.sum(u) ** 2

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v, "effort": z.effort}


def problem(u, *, t_final=1.0, steps=12, gain=1.0):
    return al.Problem(
        Cart(gain=gain),
        grid=al.Grid(t_final, steps),
        inputs={"u": u},
        minimize=al.terminal("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(0.0),
            al.terminal("v").mean.equals(-1.0),
            al.path("x").at_most(HIGHEST),
        ],
    )


def spline(points, limits=200.0, **options):
    return al.BSpline(al.Decision(np.asarray(points, dtype=float), -limits, limits), **options)


def values(declared, vector):
    """The input's curve at some fractions of the time: what a system without states makes of it."""
    model = realise(declared.simulation, np.zeros(0), vector)
    return np.asarray(model.inputs["u"].sampled(TIMES, 0.0, model.grid.t_final))


RANDOM = np.random.default_rng(5).normal(size=9)
TIMES = np.linspace(0.0, 1.0, 41)


@pytest.fixture(scope="module")
def coarse():
    """The coarsest solution of all: straight lines between points a quarter of the time apart."""
    return al.solve(problem(spline(np.zeros(5), degree=1)), between=1)


@pytest.fixture(scope="module")
def begun(coarse):
    """The curve at the start of one problem from that of another, both over the fraction of time."""

    def both(old, vector, new):
        solution = replace(coarse, problem=old, vector=np.asarray(vector, dtype=float))
        return values(old, solution.vector), values(new, started_from(new, solution))

    return both


FINER = {
    "twice as many knots": spline(np.zeros(15)),
    "one knot more": spline(np.zeros(10), knots=[1 / 6, 0.25, 1 / 3, 0.5, 2 / 3, 5 / 6]),
    "the old knots": spline(np.zeros(9)),
}


@pytest.mark.parametrize("name", FINER)
def test_a_spline_whose_knots_contain_the_old_ones_begins_as_the_same_curve(begun, name):
    before, after = begun(problem(spline(RANDOM)), RANDOM, problem(FINER[name], t_final=2.0, steps=30))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-11 * np.abs(before).max())


@pytest.mark.parametrize("t_final", [1.0, 2.0])
def test_ends_and_another_degree_keep_the_curve_where_they_allow_it(begun, t_final):
    # A parabola that starts on the move: exact in splines of any degree from two on, whatever the duration.
    parabola = problem(al.PowerSeries(start=(0.5, -1.0 / t_final), end=al.Decision(0.0, -9, 9)), t_final=t_final)
    ends = {"start": (0.5, -1.0 / t_final)}
    for new in (spline(np.zeros(7), degree=4, **ends), al.PowerSeries(start=0.5, end=0.7, middle=al.Decision(0.0))):
        before, after = begun(parabola, [0.7], problem(new, t_final=t_final))
        np.testing.assert_allclose(before, 0.5 - TIMES + 1.2 * TIMES**2, rtol=1e-12)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)


def test_a_coarser_spline_comes_as_close_as_least_squares_does(begun):
    before, after = begun(problem(spline(RANDOM)), RANDOM, problem(spline(np.zeros(5))))
    many = np.linspace(0.0, 1.0, 4001)
    exact = BSpline(np.r_[[0.0] * 4, np.arange(1, 6) / 6, [1.0] * 4], RANDOM, 3)(many)
    closest = make_lsq_spline(many, exact, [0.0] * 4 + [0.5] + [1.0] * 4, 3)
    np.testing.assert_allclose(before, exact[::100], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after, closest(TIMES), rtol=0, atol=2e-3 * np.abs(before).max())


@pytest.mark.slow
def test_decided_ends_and_spans_are_found_with_the_curve(begun):
    old = al.BSpline(al.Decision(RANDOM[:5]), spans=al.Decision(np.ones(2), 0.2, 5.0))
    new = al.BSpline(
        al.Decision(np.zeros(8)),
        start=al.Decision(0.0),
        end=al.Decision(0.0),
        spans=al.Decision(np.array([1.0, 2.0, 3.0, 1.0, 1.0, 1.0, 0.5]), 0.2, 5.0),
    )
    # The old knot stands at 3 / 9.5 of the time, where the new ones have one too.
    before, after = begun(problem(old), [*RANDOM[:5], 3.0, 6.5], problem(new))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-11)


def test_a_start_lies_within_the_bounds(coarse):
    declared = problem(spline(np.zeros(9), limits=0.25, degree=1))
    solution = replace(coarse, problem=problem(spline(np.zeros(5), degree=1)), vector=np.array([0.1, 1, 0.2, 0.1, -3]))
    found = started_from(declared, solution)
    np.testing.assert_allclose(found, [0.1, 0.25, 0.25, 0.25, 0.2, 0.15, 0.1, -0.25, -0.25], rtol=1e-12)
    narrower = problem(spline(np.zeros(5), limits=0.25, degree=1))
    np.testing.assert_allclose(started_from(narrower, solution), [0.1, 0.25, 0.2, 0.1, -0.25])


def test_what_a_solution_does_not_know_is_named(coarse):
    for unknown, received in (
        (problem(spline(np.zeros(5), degree=1), gain=al.Decision(1.0, 0.5, 2.0)), "decision 'gain'"),
        (problem(al.processes.signal(lambda t, p: p.high * t, high=al.Decision(1.0))), "decision 'inputs.u.p.high'"),
    ):
        with pytest.raises(al.ProblemError, match=f"does not have the {received}.*received a solution with the"):
            al.solve(unknown, warm_start=coarse)
    told = problem(spline(np.zeros(9), degree=1), gain=al.Decision(1.0, 0.5, 2.0))
    assert started_from(told, coarse, ["gain"]).shape == (10,)
    vectors = problem(spline(np.zeros((9, 1)), degree=1))
    with pytest.raises(al.ProblemError, match=r"of shape \(9, 1\); received shape \(5,\)"):
        started_from(vectors, coarse)


def test_from_coarse_to_fine_the_optimum_of_the_closed_form_is_reached(coarse):
    # Bryson and Denham: with the way limited to h, the least effort is 4 / (9 h), by straight lines whose corners are
    # at 3 h and 1 - 3 h: between the knots of the coarse spline, on those of the fine one.
    exact = 4 / (9 * HIGHEST)
    assert coarse.objective > 1.005 * exact
    fine = al.solve(problem(spline(np.zeros(13), degree=1), steps=24), warm_start=coarse, between=1)
    assert fine.objective == pytest.approx(exact, rel=1e-6)
    knots = np.linspace(0.0, 1.0, 13)
    expected = -2 / (3 * HIGHEST) * np.maximum(0.0, np.maximum(1 - knots / (3 * HIGHEST), 1 - (1 - knots) * 3))
    np.testing.assert_allclose(fine.decisions["inputs.u.free"], expected, rtol=0, atol=1e-3)
