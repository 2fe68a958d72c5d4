"""Random processes and uncertain signals as loads and parameters of mechanical systems, in problems."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import _instantaneous as instantaneous
from zoo import optimum

MOTION = {"x": al.BSpline(al.Decision(np.array([0.3, 0.6]), -3, 3), start=((0.0), 0.0), end=((1.0), 0.0))}
WIND = al.processes.RandomProcess(
    al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.4, mean=1.0, modes=3
)


class Cart(al.Mechanical):
    names = ("x",)
    mass: al.Number = al.parameter("kg", positive=True, default=2.0)
    wind: al.Number = 0.0

    def mass_matrix(self, q):
        return self.mass * jnp.eye(1)

    def load(self, q, v):
        return jnp.reshape(self.wind, (1,))


def problem(model, **options):
    return al.Problem(
        al.InverseDynamics(model, motion=MOTION),
        grid=al.Grid(2.0, 8),
        minimize=al.integral("x_rate").mean,
        subject_to=[al.path("x_torque").at_most(50.0, sigmas=1.0)],
        expansion=al.Expansion(order=1),
        **options,
    )


def spread(transcription):
    """The mean and the spread of the torque over time, at the start."""
    resolved = transcription.resolve(transcription.problem.placements.vector("initial"))
    return resolved["x_torque(t)"]


def test_torques_spread_as_the_process_that_they_work_against():
    declared = problem(Cart(wind=WIND))
    found = spread(transcribe(declared))
    times = jnp.linspace(0.0, 2.0, 9)
    np.testing.assert_allclose(found.std, 0.4 * np.sqrt(1 - WIND.deficit(times)), rtol=1e-9)
    moved = spread(transcribe(problem(Cart())))
    np.testing.assert_allclose(found.mean, moved.mean - 1.0, rtol=0, atol=1e-9)


def test_masses_and_loads_that_are_uncertain_stay_affine_under_a_known_gust():
    gust = al.processes.signal(lambda t, p: jnp.sin(3.0 * t))

    class Gusty(Cart):
        size: al.Number = 1.0

        def load(self, q, v):
            return jnp.reshape(self.size * self.wind, (1,)) - 0.1 * v

    model = Gusty(mass=al.Uniform(2.0, half_width=0.5), size=al.Uniform(3.0, half_width=1.0), wind=gust)
    declared = problem(model)
    few = transcribe(declared)
    x = declared.placements.vector("initial")
    anchors = instantaneous.anchors_of(few.traced, few.collocation, x)
    assert all(anchors.affine)
    assert len(anchors.points) == 3
    times, found = np.linspace(0.0, 2.0, 9), spread(few)
    acceleration = np.asarray(
        al.simulate(al.InverseDynamics(Cart(mass=1.0), motion={"x": at(x)}), al.Grid(2.0, 8))["x_torque"]
    )
    expected = np.hypot(0.5 * acceleration, np.sin(3 * times)) / np.sqrt(3)
    np.testing.assert_allclose(found.std, expected, rtol=1e-9, atol=1e-12)


def at(x):
    return al.BSpline(x, start=(0.0, 0.0), end=(1.0, 0.0))


def test_a_decided_signal_is_planned_like_any_other_number():
    # What a second engine pushes over time is decided: rest to rest in a second takes an effort of 12.
    class Effort(Cart):
        def outputs(self, motion):
            return {"effort": self.wind**2}

    push = al.BSpline(al.Decision(np.zeros(3), -20.0, 20.0), degree=1)
    declared = al.Problem(
        al.ForwardDynamics(Effort(mass=1.0, wind=push)),
        grid=al.Grid(1.0, 20),
        minimize=al.integral("effort").mean,
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("x_rate").mean.equals(0.0)],
    )
    solution = optimum(declared)
    assert solution.objective == pytest.approx(12.0, rel=1e-6)
    np.testing.assert_allclose(solution.decisions["wind.free"], [6.0, 0.0, -6.0], rtol=0, atol=1e-5)


def test_a_positive_function_of_a_process_is_a_mass():
    noise = al.processes.RandomProcess(al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.05, modes=2)
    mass = al.processes.signal(lambda t, p: 2.0 * jnp.exp(p.noise(t)), noise=noise)
    found = spread(transcribe(problem(Cart(mass=mass))))
    assert np.all(np.asarray(found.std) >= 0)
    assert np.asarray(found.std).max() > 0.01
