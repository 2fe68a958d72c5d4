"""Constrained mechanics against elimination by hand: positions, torques, multipliers; ropes; closures."""

from functools import cache
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import ClosedTree, SliderCrank, slider_crank_by_hand
from double_pendulum import simulate
from mujoco_trees import random_tree
from scipy.integrate import solve_ivp

import aleator as al
from aleator.mechanics._multibody import Multibody
from compiling import compiled

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
