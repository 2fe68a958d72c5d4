"""Random processes, uncertain signals and decisions as loads and parameters of mechanical systems, in problems."""

import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from compiling import compiled
from zoo import Cart, optimum

MOTION = {"x": al.BSpline(al.Decision(np.array([0.3, 0.6]), -3, 3), start=((0.0), 0.0), end=((1.0), 0.0))}
WIND = al.processes.RandomProcess(
    al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.4, mean=1.0, modes=3
)


def test_torques_spread_as_the_process_that_they_work_against():
    motion = al.BSpline(np.array([0.3, 0.6]), start=(0.0, 0.0), end=(1.0, 0.0))
    acceleration = np.asarray(motion.values(np.linspace(0.0, 1.0, 9), 2.0, 2))
    problem = al.Problem(
        al.InverseDynamics(Cart(wind=WIND), motion=MOTION),
        grid=al.Grid(2.0, 8),
        minimize=al.integral("x_rate").mean,
        subject_to=[al.path("x_torque").at_most(50.0, sigmas=1.0)],
        expansion=al.Expansion(order=1),
    )
    torque = transcribe(problem).resolve(problem.placements.vector("initial"))["x_torque(t)"]
    np.testing.assert_allclose(np.asarray(torque.mean), 2.0 * acceleration - 1.0, rtol=0, atol=1e-9)
    deficit = np.asarray(compiled(WIND.deficit)(np.linspace(0.0, 2.0, 9)))
    np.testing.assert_allclose(torque.std, 0.4 * np.sqrt(1 - deficit), rtol=1e-9)


@pytest.mark.slow
def test_a_decided_signal_is_planned_like_any_other_number():
    # What a second engine pushes over time is decided: rest to rest in a second takes an effort of 12.
    push = al.BSpline(al.Decision(np.zeros(3), -20.0, 20.0), degree=1)
    declared = al.Problem(
        al.ForwardDynamics(Cart(mass=1.0, wind=push)),
        grid=al.Grid(1.0, 20),
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("x_rate").mean.equals(0.0)],
    )
    solution = optimum(declared)
    assert solution.objective == pytest.approx(12.0, rel=1e-6)
    np.testing.assert_allclose(solution.decisions["wind.free"], [6.0, 0.0, -6.0], rtol=0, atol=1e-5)


@pytest.mark.slow
def test_the_fastest_way_of_an_uncertain_mass_is_bang_bang_where_a_knot_lies_in_the_middle():
    # Of degree 2 the acceleration is constant from knot to knot: 6 control points make 4 spans, a knot in the middle.
    # An odd number of steps: no instant at the knot itself, where the acceleration jumps.
    ends = {"start": (0.0, 0.0), "end": (0.7, 0.0)}
    points = al.fit_control_points(np.linspace(0.0, 0.7, 200), 2, degree=2, **ends)
    motion = al.BSpline(al.Decision(points, -1.0, 2.0), degree=2, **ends)
    problem = al.Problem(
        al.InverseDynamics(Cart(al.Uniform(2.0, std=0.25)), motion={"x": motion}),
        grid=al.Grid(al.Decision(3.0, 0.1, 9.0), 39),
        minimize=al.objectives.final_time(),
        subject_to=al.path("x_torque").within(-3.0, 3.0, sigmas=2.0),
        expansion=al.Expansion(order=1),
    )
    assert optimum(problem).objective == pytest.approx(2 * np.sqrt(0.7 * (2.0 + 2.0 * 0.25) / 3.0), rel=1e-7)
