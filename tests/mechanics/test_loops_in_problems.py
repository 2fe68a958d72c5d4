"""Driven and passive loops as simultaneous programs: the least effort, and a start that depends on the instant."""

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import SliderCrank, slider_crank_by_hand
from numpy.polynomial import Polynomial
from scipy.optimize import minimize

import aleator as al
from aleator.transcription import transcribe
from zoo import optimum

START, END, RATE, DURATION = 0.3, 2.3, 4.0, 0.5
FAMILY = al.Uniform(0.5, half_width=0.1)
"""Of the rod's mass."""


@pytest.mark.slow
def test_the_least_effort_of_a_driven_loop_is_that_of_elimination():
    """The crank's torque by Newton and Euler along each quintic, and its mean square by Gauss and Legendre's rules."""
    # A crank that keeps its speed at both ends, with free accelerations there.
    first, last = (al.Decision(value, -60.0, 60.0) for value in (0.5, -0.5))
    motion = {"crank": al.PowerSeries(start=(START, RATE, first), end=(END, RATE, last))}
    problem = al.Problem(
        al.InverseDynamics(SliderCrank(rod_mass=FAMILY), motion=motion, guess={"rod": -0.1, "slider": 0.4}),
        grid=al.Grid(DURATION, 40),
        minimize=al.objectives.effort("crank_torque"),
        # The torque is affine in the rod's mass, so that order 2 has the mean of its square exactly.
        expansion=al.Expansion(order=2),
    )
    found = optimum(problem, transcription=al.Simultaneous())
    nodes, weights = np.polynomial.legendre.leggauss(40)
    times, weights = DURATION / 2 * (1 + nodes), DURATION / 2 * weights

    def effort(accelerations):
        motion = quintic(*accelerations)
        crank = [motion.deriv(k)(times) if k else motion(times) for k in range(3)]
        masses = 0.5 + 0.1 / np.sqrt(3) * np.array([-1.0, 1.0])
        torques = [slider_crank_by_hand(*crank, rod_mass=mass)["torque"] for mass in masses]
        return np.mean([weights @ torque**2 for torque in torques])

    best = minimize(effort, (0.0, 0.0), tol=1e-10)
    assert found.objective == pytest.approx(best.fun, rel=1e-6)
    np.testing.assert_allclose(list(found.decisions.values()), best.x, rtol=1e-3, atol=1e-2)


def quintic(first, last):
    """The crank's angle over time, from the values, rates and accelerations at both ends."""
    powers = [Polynomial.basis(k) for k in range(6)]
    rows = [[one.deriv(k)(t) if k else one(t) for one in powers] for t in (0.0, DURATION) for k in range(3)]
    return Polynomial(np.linalg.solve(rows, [START, RATE, first, END, RATE, last]))


class Growing(SliderCrank):
    """A rod that is as long as the time says, so that the start is known only at its instant."""

    def constraint(self, q, t):
        length = self.b + 0.05 * jnp.cos(t)
        return (
            self.a * jnp.cos(q[0]) + length * jnp.cos(q[1]) - q[2],
            self.a * jnp.sin(q[0]) + length * jnp.sin(q[1]),
        )


@pytest.mark.slow
def test_a_start_that_depends_on_the_instant_is_that_of_the_simulation():
    torque = {"crank_torque": al.BSpline(al.Decision(np.zeros(4), -5.0, 5.0), degree=2)}
    start = {"crank": START, "crank_rate": RATE}
    problem = al.Problem(
        al.ForwardDynamics(Growing(rod_mass=FAMILY), torque=torque, start=start, guess={"rod": -0.1, "slider": 0.4}),
        grid=al.Grid(DURATION, 4),
        minimize=al.integral("constraint_error").mean,
        expansion=al.Expansion(order=1),
    )
    transcribed = transcribe(problem, al.Simultaneous(al.schemes.Radau(1)))
    crank, rod, slider = np.moveaxis(
        transcribed.layout.view(transcribed.program.start).phases[0].states[:, 0, :3], 1, 0
    )
    np.testing.assert_allclose(crank, 0.3, rtol=1e-14)
    np.testing.assert_allclose(np.sin(rod), -0.1 / 0.35 * np.sin(0.3), rtol=1e-9)
    np.testing.assert_allclose(slider, 0.1 * np.cos(0.3) + 0.35 * np.cos(rod), rtol=1e-9)
