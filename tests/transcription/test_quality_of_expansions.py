"""What a solution says of its expansion: where it fails, from when on, and when nothing can be said."""

import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.expansion import collocate
from aleator.nlp import Status
from aleator.transcription.sequential import EVALUATE
from aleator.uncertainty import LegendreGerm

GRID = al.Grid(30.0, 300)
ORDER = 4


class Phase(al.System):
    """`x = cos(w t)`, no dynamics: the spread of `w` bends `x` over the germ more and more."""

    states = ("nothing",)
    w: Any
    gain: Any

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {"x": jnp.cos(self.w * t), "loss": (self.gain - 1.0) ** 2}


def phase_problem(grid=GRID, **expansion):
    return al.Problem(
        Phase(al.Uniform(2.0, half_width=0.2), al.Decision(0.5, 0.0, 3.0)),
        grid=grid,
        minimize=al.terminal("loss").mean,
        subject_to=[al.path("x").at_most(5.0, sigmas=1.0)],
        expansion=al.Expansion(**({"order": ORDER} | expansion)),
    )


def lost_variance():
    """The part of the variance beyond the order at each instant, relative to the largest variance so far, by Gauss."""
    nodes, weights = LegendreGerm().gauss(60)
    samples = np.cos(np.outer(2.0 + 0.2 * nodes, np.asarray(GRID.times)))
    energy = (LegendreGerm().polynomials(40, nodes).T * weights @ samples) ** 2
    variance = np.maximum.accumulate(energy[1:].sum(axis=0))
    return energy[ORDER + 1 :].sum(axis=0)[1:] / variance[1:]


def test_a_long_simulation_is_followed_until_an_instant_that_the_warning_names():
    expected = float(np.asarray(GRID.times)[1 + np.argmax(lost_variance() > 0.05**2)])
    with pytest.warns(al.ExpansionWarning, match=r"order 4 does not resolve x\(t\) .* from t = 1\d.* s on"):
        solution = al.solve(phase_problem(), throw=False)
    assert solution.status is Status.UNRESOLVED
    assert "misses x(t) by" in solution.why()
    # A sample is predicted from the others a little worse than the best approximation.
    assert 0.75 * expected <= solution.certificate.expansion.unresolved_from["x(t)"] <= expected
    assert solution.certificate.expansion.unresolved == ("x(t)",)


def test_the_same_simulation_cut_short_is_resolved():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(phase_problem(al.Grid(6.0, 60)))
    assert solution.certificate.expansion.unresolved_from == {}
    assert solution.certificate.expansion.unresolved == ()


def test_as_many_points_as_terms_leave_nothing_to_check_by():
    with pytest.warns(al.ExpansionWarning, match="5 points for 5 terms leave nothing to check the expansion"):
        solution = al.solve(phase_problem(al.Grid(6.0, 60), points=5))
    assert not solution.certificate.expansion.can_be_checked


class Glider(al.System):
    """A mass that is pushed there and back: whatever it weighs, it comes to rest, up to rounding."""

    states = ("x", "v")
    mass: Any

    def rhs(self, t, z, u):
        return z.v, u / self.mass

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v}


@pytest.mark.parametrize("steps", [80, 160])
def test_a_rate_that_is_zero_at_the_end_of_every_motion_is_not_called_unresolved(steps):
    times = np.linspace(0.0, 1.0, 21)
    push = np.random.default_rng(0).normal(size=21)
    push -= push[::-1]  # odd about the middle, so that it takes back what it gives
    problem = al.Problem(
        Glider(al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.3)),
        grid=al.Grid(1.0, steps),
        inputs={"u": al.Tabulated(times, push)},
        minimize=al.terminal("v").variance + (al.rms("v").mean - 0.3),
        subject_to=[al.terminal("v").within(-1.0, 1.0, sigmas=1.0)],
        expansion=al.Expansion(order=5),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = al.solve(problem)
    assert float(solution.moments["v(t_f)"].std) < 1e-10
    assert solution.certificate.expansion.unresolved == ()


def test_the_tolerance_compiles_nothing_anew():
    short = al.Grid(6.0, 60)
    al.solve(phase_problem(short))
    before = EVALUATE.compilations
    with pytest.warns(al.ExpansionWarning, match="exceeds 1e-06"):
        solution = al.solve(phase_problem(short, tolerance=1e-6))
    assert EVALUATE.compilations == before
    assert solution.certificate.expansion.tolerance == 1e-6


def test_a_solution_says_which_corner_no_point_lies_in():
    solution = al.solve(phase_problem(al.Grid(6.0, 60)))
    levels = np.sort((1 + np.asarray(solution_points(solution))[:, 0]) / 2)
    corner = solution.certificate.expansion.unseen
    assert corner is not None
    assert corner.probability == pytest.approx(max(levels[0], 1 - levels[-1]), rel=1e-9)
    assert "the largest corner without a point (w " in str(solution)


def solution_points(solution):
    return collocate(solution.problem.placements.germs, solution.problem.expansion).collocation.points
