"""Constrained mechanics against elimination by hand: positions, torques, multipliers; ropes; closures; a problem."""

from functools import cache
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import ClosedTree, SliderCrank, slider_crank_by_hand
from double_pendulum import simulate
from mujoco_trees import random_tree
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

import aleator as al
from aleator.mechanics._multibody import Multibody
from compiling import compiled
from zoo import optimum

TURNS = al.PowerSeries(start=(0.7, 5.0, 1.0), end=(20.0, 1.0))
GRID = al.Grid(2.0, 200)


@cache
def driven_slider_crank():
    return simulate(al.InverseDynamics(SliderCrank(), motion={"crank": TURNS}, guess={"slider": 0.4}), GRID)


def by_hand(found):
    return slider_crank_by_hand(*(found[f"crank{end}"] for end in ("", "_rate", "_acceleration")))


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_a_driven_slider_crank_is_that_of_elimination_by_hand_over_three_turns():
    found = driven_slider_crank()
    expected = by_hand(found)
    for name in ("rod", "slider", "rod_rate", "rod_acceleration", "slider_acceleration"):
        close(found[name], expected[name])
    close(found["crank_torque"], expected["torque"])
    # The multipliers are the forces on the rod's end, with the sign of equation (6).
    close(found["length_multiplier"], -expected["wrist"][0])
    close(found["height_multiplier"], -expected["wrist"][1])
    close(found["slider_reaction"], -expected["wrist"][0])
    # By the parabola through five neighbours: fourth order in the step.
    torque = found["crank_torque"]
    slope = (-torque[4:] + 8 * torque[3:-1] - 8 * torque[1:-3] + torque[:-4]) / (12 * 0.01)
    np.testing.assert_allclose(found["crank_torque_rate"][2:-2], slope, rtol=0, atol=5e-3 * np.abs(slope).max())


@pytest.mark.slow
def test_a_driven_tree_that_is_closed_is_that_of_elimination_by_hand_and_its_multipliers_the_force_in_the_pin():
    found = simulate(al.InverseDynamics(ClosedTree(), motion={"crank": TURNS}, guess={"slider": 0.4}), GRID)
    expected = by_hand(found)
    rod = found["crank"] + found["rod"]
    close(np.exp(1j * rod), np.exp(1j * expected["rod"]))
    close(found["slider"], expected["slider"])
    close(found["crank_torque"], expected["torque"])
    # On the slider by the rod, in the rod's axes.
    x, y = (found[f"pin_{end}_multiplier"] for end in "xy")
    force = np.stack([np.cos(rod) * x - np.sin(rod) * y, np.sin(rod) * x + np.cos(rod) * y])
    close(force, -expected["wrist"])
    # The branch is kept through whole turns: the angle beside the crank goes round as often.
    assert np.abs(np.diff(found["rod"])).max() < 0.3
    assert found["rod"][-1] < -3 * 2 * np.pi + 1


@pytest.mark.slow
def test_a_passive_slider_crank_moves_as_the_reduced_equation_does_and_keeps_constraints():
    def rates(t, z):
        # Reduced: the torque by hand is affine in the acceleration, and none is given.
        still, unit = (slider_crank_by_hand(*(np.array([one]) for one in (z[0], z[1], a)))["torque"][0] for a in (0, 1))
        return z[1], -still / (unit - still)

    times = np.asarray(al.Grid(2.0, 200).times)
    expected = solve_ivp(rates, (0.0, 2.0), (0.7, 5.0), t_eval=times, rtol=1e-11, atol=1e-12).y[0]
    start = {"crank": 0.7, "crank_rate": 5.0}
    system = al.ForwardDynamics(SliderCrank(), start=start, guess={"slider": 0.4})
    found = simulate(system, al.Grid(2.0, 400))
    np.testing.assert_allclose(found["crank"][::2], expected, rtol=0, atol=1e-6)
    assert found["constraint_drift"].max() < 1e-8
    assert found["constraint_error"].max() < 1e-13


class Rod(al.Lagrangian):
    """A pendulum in Cartesian coordinates, which an event stretches at the bottom."""

    coordinates = ("x", "y")
    constraint_names = ("length",)
    stretch: al.Number
    events: ClassVar = {
        "bottom": al.Event(lambda self, t, z: z.q[0], jump=lambda self, t, z: {"q": self.stretch * z.q})
    }

    def kinetic_energy(self, q, v):
        return 0.5 * v @ v

    def potential_energy(self, q):
        return 9.81 * q[1]

    def constraint(self, q):
        return (q @ q - 1.0,)


@pytest.mark.slow
def test_coordinates_that_jump_off_a_constraint_a_little_are_put_back_and_others_refused():
    start, grid = {"x": 0.6, "y": -0.8}, al.Grid(1.0, 50)
    stretched, same = (simulate(al.ForwardDynamics(Rod(size), start=start), grid)["x"] for size in (1.002, 1.0))
    np.testing.assert_allclose(stretched, same, rtol=0, atol=1e-9)
    with pytest.warns(al.SimulationWarning, match=r"constraints of Rod cannot be obeyed.*missed by 0\.02"):
        al.simulate(al.ForwardDynamics(Rod(1.01), start=start), grid)


# --- Constraints that depend on time, and closures of a tree ----------------------------------------------------------


class Loops(Multibody):
    given: tuple
    joined: tuple

    def bodies(self):
        return self.given

    def closures(self):
        return self.joined


class Winch(al.Mechanical):
    """A weight on a rope that is let out: `x² + y² = length(t)²`."""

    names = ("x", "y")
    actuator_names = ()
    constraint_names = ("rope",)

    length: al.Number = 1.0

    def mass_matrix(self, q):
        return 2.0 * jnp.eye(2)

    def forces(self, q, v):
        return jnp.array([0.0, 2.0 * 9.81])

    def actuation(self, q):
        return jnp.zeros((2, 0))

    def constraint(self, q):
        return (jnp.sqrt(q @ q) - self.length,)


def test_a_rope_that_is_let_out_moves_as_in_polar_coordinates():
    model = Winch(length=al.PowerSeries(start=(1.0, 0.3, 0.4), end=(1.5,)))
    grid = al.Grid(1.0, 200)
    system = al.ForwardDynamics(model, start={"x": 0.6}, guess={"y": -0.8})
    found = simulate(system, grid)

    def rates(t, z):
        length, rate = 1.0 + 0.3 * t + 0.2 * t**2, 0.3 + 0.4 * t
        return z[1], -(2 * rate * z[1] + 9.81 * np.sin(z[0])) / length

    # The velocity nearest to rest is that along the rope.
    start = (np.arcsin(0.6), 0.0)
    angle, turning = solve_ivp(rates, (0.0, 1.0), start, t_eval=np.asarray(grid.times), rtol=1e-11, atol=1e-12).y
    times = np.asarray(grid.times)
    length = 1.0 + 0.3 * times + 0.2 * times**2
    np.testing.assert_allclose(found["x"], length * np.sin(angle), atol=1e-8)
    np.testing.assert_allclose(found["y"], -length * np.cos(angle), atol=1e-8)
    # The pull of the rope: weight and centrifugal force, less what the rope gives way.
    tension = 2.0 * (9.81 * np.cos(angle) + length * turning**2 - 0.4)
    np.testing.assert_allclose(found["rope_multiplier"], tension, atol=1e-6)


def test_the_jacobian_of_closures_is_the_derivative_of_what_is_left_of_them():
    joints = (al.joints.Revolute("y"), al.joints.Prismatic((1.0, 2.0, -0.5)), al.joints.Fixed(), al.joints.Ball())
    tree, mj = random_tree(["revolute", "ball", "prismatic"], [-1, 0, -1], 3)
    closures = tuple(
        al.joints.Closure(f"c{k}", parent="b1", child="b2", joint=joint, orientation=(0.3, -0.2, 0.5))
        for k, joint in enumerate(joints)
    )
    model = Loops(tree.given, closures)
    q = model.normalised(np.random.default_rng(5).normal(size=mj.nq))

    @compiled
    def both(q):
        return model.closing_jacobian(q), jax.jacfwd(model.closing)(q) @ model.velocity_map(q)

    ours, expected = both(q)
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12)
    assert len(model.constraints) == len(ours) == 5 + 5 + 6 + 3
    assert ClosedTree().constraints == ("pin_x", "pin_y")


# --- A driven loop as a simultaneous program --------------------------------------------------------------------------


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
