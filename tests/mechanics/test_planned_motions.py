"""Planned motions against closed forms."""

import numpy as np
import pytest

import aleator as al
from zoo import optimum


class Cart(al.Mechanical):
    """A mass on a line: `m q̈ = τ`."""

    names = ("q",)
    mass: al.Number = al.parameter("kg", positive=True)

    def mass_matrix(self, q):
        return self.mass * np.ones((1, 1))


def cart(free, degree, distance=0.7, limit=3.0, sigmas=2.0, steps=240):
    """The fastest way from rest to rest with `|q̈| (μ_m + k σ_m) <= τ_max`."""
    ends = {"start": (0.0, 0.0), "end": (distance, 0.0)}
    points = al.fit_control_points(np.linspace(0.0, distance, 200), free, degree=degree, **ends)
    motion = al.BSpline(al.Decision(points, -1.0, 2.0), degree=degree, **ends)
    return al.Problem(
        al.InverseDynamics(Cart(al.Uniform(2.0, std=0.25)), motion={"q": motion}),
        grid=al.Grid(al.Decision(3.0, 0.1, 9.0), steps),
        minimize=al.objectives.final_time(),
        subject_to=al.path("q_torque").within(-limit, limit, sigmas=sigmas),
        expansion=al.Expansion(order=1),
    )


EXACT = 2 * np.sqrt(0.7 * (2.0 + 2.0 * 0.25) / 3.0)


def test_the_fastest_way_of_an_uncertain_mass_is_bang_bang_where_a_knot_lies_in_the_middle():
    # Of degree 2 the acceleration is constant from knot to knot: 6 control points make 4 spans, a knot in the middle.
    # An odd number of steps: no instant at the knot itself, where the acceleration jumps.
    assert optimum(cart(2, degree=2, steps=39)).objective == pytest.approx(EXACT, rel=1e-7)


def test_the_least_effort_of_a_double_integrator_is_twelve():
    motion = al.BSpline(al.Decision(np.linspace(0.2, 0.8, 5)), start=(0.0, 0.0), end=(1.0, 0.0))
    problem = al.Problem(
        al.InverseDynamics(Cart(1.0), motion={"q": motion}),
        grid=al.Grid(1.0, 100),
        minimize=al.objectives.effort("q_torque"),
    )
    # The cubic 3t² - 2t³ is among the splines, and Simpson's rule integrates the square of its acceleration exactly.
    assert optimum(problem).objective == pytest.approx(12.0, rel=1e-7)
