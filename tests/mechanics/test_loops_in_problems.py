"""Trees of bodies closed to loops as simultaneous programs: forward and inverse dynamics, by both ways."""

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import SliderCrank as Linkage
from closed_loops import slider_crank_by_hand
from numpy.polynomial import Polynomial
from scipy.optimize import minimize

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.simultaneous._guess import state_shapes

A, B, CRANK_INERTIA, ROD_MASS, SLIDER_MASS = 0.1, 0.3, 0.01, 0.5, 0.7
NEAR = {"rod": -0.4, "slider": 0.4}
START, END, RATE, DURATION = 0.3, 2.3, 4.0, 0.5


class SliderCrank(al.Multibody):
    """Crank and rod, the rod measured from the crank, and a slider that the closure binds to the rod's end."""

    units = {"effort": "N²·m²"}  # noqa: RUF012
    gravity = (0.0, -9.81, 0.0)

    rod_mass: al.Number = ROD_MASS

    def bodies(self):
        turning = {"joint": al.joints.Revolute("z"), "center": (0.0, 0.0, 0.0)}
        rod = (0.0, 0.0, self.rod_mass * B**2 / 12)
        return (
            al.Body("crank", mass=0.0, inertia=(0.0, 0.0, CRANK_INERTIA), **turning),
            al.Body(
                "rod",
                parent="crank",
                position=(A, 0.0, 0.0),
                mass=self.rod_mass,
                inertia=rod,
                **turning | {"center": (B / 2, 0.0, 0.0)},
            ),
            al.Body("slider", joint=al.joints.Prismatic("x"), mass=SLIDER_MASS),
        )

    def closures(self):
        pin = al.joints.Revolute("z")
        return (al.joints.Closure("pin", parent="rod", child="slider", joint=pin, position=(B, 0.0, 0.0), planar=True),)

    @property
    def actuators(self):
        return ("crank_torque",)

    def outputs(self, motion):
        return {"effort": motion.torque[0] ** 2}


def family():
    return SliderCrank(rod_mass=al.Uniform(ROD_MASS, half_width=0.1))


def turning():
    """A crank that keeps its speed at both ends, with free accelerations there."""
    ends = (al.Decision(value, -60.0, 60.0) for value in (0.5, -0.5))
    return al.PowerSeries(start=(START, RATE, next(ends)), end=(END, RATE, next(ends)))


def forward():
    torque = al.BSpline(al.Decision(np.zeros(4), -5.0, 5.0), degree=2)
    start = {"crank": START, "crank_rate": RATE}
    limits = [al.terminal("crank").mean.equals(END), al.terminal("crank_rate").mean.equals(RATE)]
    return al.ForwardDynamics(family(), torque={"crank_torque": torque}, start=start, guess=NEAR), limits


def inverse():
    return al.InverseDynamics(family(), motion={"crank": turning()}, guess=NEAR), []


def solved_both_ways(made):
    system, limits = made()
    problem = al.Problem(
        system,
        grid=al.Grid(DURATION, 40),
        minimize=al.integral("effort").mean,
        subject_to=limits,
        # The torque is affine in the rod's mass, so that order 2 has the mean of its square exactly.
        expansion=al.Expansion(order=2),
    )
    usual, other = (al.solve(problem, transcription=one, accuracy=5e-2) for one in (al.Sequential(), al.Simultaneous()))
    assert usual.ok
    assert other.ok
    assert other.objective == pytest.approx(usual.objective, rel=1e-6)
    np.testing.assert_allclose(other.vector, usual.vector, rtol=1e-4, atol=1e-4)
    assert set(other.costates.values) == set(problem.system.states)
    return other


@pytest.mark.slow
def test_a_tree_closed_to_a_loop_has_the_same_optimum_by_collocation():
    solved_both_ways(forward)


@pytest.mark.slow
def test_the_least_effort_of_a_driven_loop_is_that_of_elimination():
    """The crank's torque by Newton and Euler along each quintic, and its mean square by Gauss and Legendre's rules."""
    found = solved_both_ways(inverse)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    times, weights = DURATION / 2 * (1 + nodes), DURATION / 2 * weights

    def effort(accelerations):
        motion = quintic(*accelerations)
        crank = [motion.deriv(k)(times) if k else motion(times) for k in range(3)]
        masses = ROD_MASS + 0.1 / np.sqrt(3) * np.array([-1.0, 1.0])
        torques = [slider_crank_by_hand(*crank, rod_mass=mass)["torque"] for mass in masses]
        return np.mean([weights @ torque**2 for torque in torques])

    best = minimize(effort, (0.0, 0.0), tol=1e-10)
    assert found.objective == pytest.approx(best.fun, rel=1e-6)
    np.testing.assert_allclose(found.vector, best.x, rtol=1e-3, atol=1e-2)


def quintic(first, last):
    """The crank's angle over time, from the values, rates and accelerations at both ends."""
    powers = [Polynomial.basis(k) for k in range(6)]
    rows = [[one.deriv(k)(t) if k else one(t) for one in powers] for t in (0.0, DURATION) for k in range(3)]
    return Polynomial(np.linalg.solve(rows, [START, RATE, first, END, RATE, last]))


class Growing(Linkage):
    """A rod that is as long as the time says, so that the start is known only at its instant."""

    def constraint(self, q, t):
        length = self.b + 0.05 * jnp.cos(t)
        return (
            self.a * jnp.cos(q[0]) + length * jnp.cos(q[1]) - q[2],
            self.a * jnp.sin(q[0]) + length * jnp.sin(q[1]),
        )


def turned(model: al.Lagrangian, steps: int) -> al.Problem:
    """Turn the crank of a family of slider-cranks by two radians, as fast at the end as at first."""
    torque = al.BSpline(al.Decision(np.zeros(4), -5.0, 5.0), degree=2)
    start = {"crank": 0.3, "crank_rate": 4.0}
    return al.Problem(
        al.ForwardDynamics(model, torque={"crank_torque": torque}, start=start, guess={"rod": -0.1, "slider": 0.4}),
        grid=al.Grid(0.5, steps),
        minimize=al.integral("constraint_error").mean,
        subject_to=[
            al.terminal("crank").mean.equals(2.3),
            al.terminal("crank_rate").mean.equals(4.0),
        ],
        expansion=al.Expansion(order=1),
    )


@pytest.mark.slow
def test_a_start_that_depends_on_the_instant_is_that_of_the_simulation():
    problem = turned(Growing(rod_mass=al.Uniform(0.5, half_width=0.1)), 4)
    transcribed = transcribe(problem, al.Simultaneous(al.schemes.Radau(1)))
    crank, rod, slider = np.moveaxis(transcribed.layout.view(transcribed.program.start).states[:, 0, :3], 1, 0)
    np.testing.assert_allclose(crank, 0.3, rtol=1e-14)
    np.testing.assert_allclose(np.sin(rod), -0.1 / 0.35 * np.sin(0.3), rtol=1e-9)
    np.testing.assert_allclose(slider, 0.1 * np.cos(0.3) + 0.35 * np.cos(rod), rtol=1e-9)
    tied = transcribed.program.ties.rows
    first = transcribed.program.evaluate(transcribed.program.start).constraints[tied]
    begun = np.isin(transcribed.program.ties.variables, transcribed.layout.numbers.states[:, 0])
    np.testing.assert_allclose(first[begun], 0.0, atol=1e-12)


@pytest.mark.slow
def test_the_states_of_driven_loops_are_known_by_name_before_anything_is_simulated():
    """Their start follows from constraints and signals of the first instant."""
    problem = al.Problem(inverse()[0], grid=al.Grid(0.5, 4), minimize=al.terminal("crank").mean)
    assert state_shapes(problem) == {"q": (2,)}
