"""Planned motions against closed forms and against an optimal control problem solved by another tool."""

import casadi as ca
import numpy as np
import pytest

import aleator as al
from aleator.studies.two_link_arm import START, TARGET, TORQUE, TwoLinkArm


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
    solution = al.solve(cart(2, degree=2, steps=239), between=1)
    # An odd number of steps: no instant at the knot itself, where the acceleration jumps.
    assert solution.objective == pytest.approx(EXACT, rel=1e-7)


def test_the_final_time_falls_to_the_closed_form_as_control_points_are_added():
    times = [al.solve(cart(free, degree=3)).objective for free in (3, 9, 27)]
    excess = np.array(times) / EXACT - 1
    assert np.all(excess > 0)
    assert np.all(excess[1:] < 0.5 * excess[:-1])
    assert excess[-1] < 0.02


def test_the_least_effort_of_a_double_integrator_is_twelve():
    motion = al.BSpline(al.Decision(np.linspace(0.2, 0.8, 5)), start=(0.0, 0.0), end=(1.0, 0.0))
    problem = al.Problem(
        al.InverseDynamics(Cart(1.0), motion={"q": motion}),
        grid=al.Grid(1.0, 100),
        minimize=al.objectives.effort("q_torque"),
    )
    # The cubic 3t² - 2t³ is among the splines, and Simpson's rule integrates the square of its acceleration exactly.
    assert al.solve(problem).objective == pytest.approx(12.0, rel=1e-7)


@pytest.mark.slow
def test_thirty_control_points_come_within_two_percent_of_the_bang_bang_optimum_of_two_links():
    found = al.solve(_two_links(26)).objective
    assert _bang_bang() <= found * (1 + 1e-3)
    assert found <= 1.02 * _bang_bang()


def _two_links(free):
    ends = {"start": (START, 0.0), "end": (TARGET, 0.0)}
    bend = np.sin(np.pi * np.linspace(0, 1, 200)) ** 2
    path = np.linspace(START, TARGET, 200) + np.stack([-0.8 * bend, 1.6 * bend], axis=1)
    arm = TwoLinkArm(payload=1.0)
    motion = al.BSpline(al.Decision(al.fit_control_points(path, free, **ends), -4.0, 4.0), **ends)
    return al.Problem(
        al.InverseDynamics(arm, motion=motion),
        grid=al.Grid(al.Decision(2.0, 0.5, 6.0), 270),
        minimize=al.objectives.final_time(),
        subject_to=[al.path(name).within(-TORQUE, TORQUE) for name in arm.actuators],
    )


def _bang_bang(intervals=120):
    """The least time by multiple shooting with torques that are constant on each of many intervals."""
    q, v, u, t = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("u", 2), ca.SX.sym("t")
    inner, outer = 1 / 3 + 2.0, 1 / 3 + 1.0
    c, s = 1.5 * ca.cos(q[1]), 1.5 * ca.sin(q[1])
    M = ca.vertcat(ca.horzcat(inner + outer + 2 * c, outer + c), ca.horzcat(outer + c, outer))
    bias = ca.vertcat(-s * (2 * v[0] * v[1] + v[1] ** 2), s * v[0] ** 2)
    rate = ca.Function("rate", [ca.vertcat(q, v), u], [ca.vertcat(v, ca.solve(M, u - bias))])
    z, h = ca.SX.sym("z", 4), t / intervals
    k1 = rate(z, u)
    k2 = rate(z + h / 2 * k1, u)
    k3 = rate(z + h / 2 * k2, u)
    k4 = rate(z + h * k3, u)
    step = ca.Function("step", [z, u, t], [z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    opti = ca.Opti()
    Z, U, T = opti.variable(4, intervals + 1), opti.variable(2, intervals), opti.variable()
    opti.subject_to(Z[:, 1:] == step.map(intervals)(Z[:, :-1], U, ca.repmat(T, 1, intervals)))
    opti.subject_to(Z[:, 0] == ca.DM([*START, 0, 0]))
    opti.subject_to(Z[:, -1] == ca.DM([*TARGET, 0, 0]))
    opti.subject_to(opti.bounded(-TORQUE, U, TORQUE))
    opti.subject_to(opti.bounded(0.5, T, 5.0))
    bend = np.sin(np.pi * np.linspace(0, 1, intervals + 1)) ** 2
    line = np.linspace(START, TARGET, intervals + 1) + np.stack([-0.8 * bend, 1.6 * bend], axis=1)
    opti.set_initial(Z[:2, :], line.T)
    opti.set_initial(T, 2.0)
    opti.minimize(T)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 500})
    return float(opti.solve().value(T))
