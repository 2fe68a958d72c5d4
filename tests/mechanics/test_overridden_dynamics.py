"""What a subclass of `al.Multibody` changes of the equations of its bodies counts in all three dynamics."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from compiling import compiled

DRAG, ROTOR = 3.0, 4.0


class Slide(al.Multibody):
    """1 kg on a level slide."""

    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("a", joint=al.joints.Prismatic("x"), mass=1.0),)


class Dragged(Slide):
    def bias(self, q, v):
        return super().bias(q, v) + DRAG * v


class Geared(Slide):
    def mass_matrix(self, q):
        return super().mass_matrix(q) + ROTOR * jnp.eye(1)


class Doubled(Slide):
    """Its velocity is half the rate of its coordinate."""

    def velocity_map(self, q):
        return 2.0 * jnp.eye(1)


class Two(Dragged):
    """Two such slides, the second without a motor."""

    actuators = ("a_torque",)

    def bodies(self):
        return tuple(al.Body(name, joint=al.joints.Prismatic("x"), mass=1.0) for name in "ab")


@pytest.mark.slow
def test_drag_in_the_bias_slows_what_is_driven_forwards():
    found = al.simulate(al.ForwardDynamics(Dragged(), start={"a_rate": 1.0}), al.Grid(1.0, 100))
    np.testing.assert_allclose(found["a_rate"], np.exp(-DRAG * np.linspace(0, 1, 101)), rtol=1e-7)


def test_drag_in_the_bias_takes_a_torque_of_a_prescribed_motion():
    motion = {"a": al.PowerSeries(start=(0.0, 1.0))}
    found = al.simulate(al.InverseDynamics(Dragged(), motion=motion), al.Grid(1.0, 4))
    np.testing.assert_allclose(found["a_torque"], DRAG, rtol=1e-14)


def test_drag_in_the_bias_acts_on_prescribed_and_passive_joints_alike():
    system = al.HybridDynamics(Two(), motion={"a": al.PowerSeries(start=(0.0, 1.0))}, start={"b_rate": 1.0})
    found = al.simulate(system, al.Grid(1.0, 100))
    np.testing.assert_allclose(found["a_torque"], DRAG, rtol=1e-13)
    np.testing.assert_allclose(found["b_rate"], np.exp(-DRAG * np.linspace(0, 1, 101)), rtol=1e-7)


def test_a_rotor_in_the_mass_matrix_resists_acceleration():
    driven = al.simulate(al.ForwardDynamics(Geared(), torque={"a_torque": 1.0}), al.Grid(1.0, 4))
    np.testing.assert_allclose(driven["a_acceleration"], 1 / (1 + ROTOR), rtol=1e-14)
    motion = {"a": al.PowerSeries(start=(0.0, 0.0, 1.0))}
    planned = al.simulate(al.InverseDynamics(Geared(), motion=motion), al.Grid(1.0, 4))
    np.testing.assert_allclose(planned["a_torque"], 1 + ROTOR, rtol=1e-14)


def test_a_velocity_map_of_one_s_own_makes_the_rates():
    assert not Doubled().moves_directly
    found = al.simulate(al.ForwardDynamics(Doubled(), start={"a_rate": 1.0}), al.Grid(1.0, 4), only=["a"])
    np.testing.assert_allclose(found["a"], 2.0 * np.linspace(0, 1, 5), rtol=1e-14)


def test_what_is_added_to_a_tree_of_several_joints_is_added_to_its_recursions():
    class Arm(al.Multibody):
        def bodies(self):
            rod = {"mass": 1.0, "center": (0.5, 0.1, 0.0), "inertia": (0.02, 0.1, 0.1)}
            return (
                al.Body("one", joint=al.joints.Revolute("y", damping=0.2), **rod),
                al.Body("two", parent="one", joint=al.joints.Revolute((1, 0, 1)), position=(1.0, 0.0, 0.0), **rod),
            )

    class Rubbed(Arm):
        def bias(self, q, v):
            return super().bias(q, v) + jnp.tanh(v)

    q, v, v_dot = np.random.default_rng(0).normal(size=(3, 2))

    @compiled
    def all_of(model, q, v, v_dot):
        force = model.inverse_dynamics(q, v, v_dot)
        return force, model.forward_dynamics(q, v, force)

    (plain, _), (rubbed, found) = (all_of(model, q, v, v_dot) for model in (Arm(), Rubbed()))
    np.testing.assert_allclose(rubbed, plain + np.tanh(v), rtol=1e-12)
    np.testing.assert_allclose(found, v_dot, rtol=1e-11)


def test_units_are_told_by_joints_and_one_s_own_come_before_them():
    class Mixed(al.Multibody):
        units: ClassVar = {"lift_torque": "daN"}

        def bodies(self):
            return (
                al.Body("turn", joint=al.joints.Revolute("z"), mass=1.0, inertia=(0, 0, 1.0)),
                al.Body("lift", parent="turn", joint=al.joints.Prismatic("z"), mass=1.0),
                al.Body("head", parent="lift", joint=al.joints.Ball(), mass=1.0, inertia=(1.0, 1.0, 1.0)),
            )

    units = al.ForwardDynamics(Mixed()).units
    assert [units[f"turn{end}"] for end in ("", "_rate", "_torque")] == ["rad", "rad/s", "N·m"]
    assert [units[f"lift{end}"] for end in ("", "_rate", "_torque")] == ["m", "m/s", "daN"]
    assert [units[f"head_omega_x{end}"] for end in ("", "_torque")] == ["rad/s", "N·m"]
    assert "head_w" not in units


@pytest.mark.parametrize("part", ["damping", "armature"])
def test_a_damping_that_would_drive_a_joint_and_a_negative_armature_are_refused(part):
    class Driven(al.Multibody):
        number: al.Number = -1.0

        def bodies(self):
            return (al.Body("a", joint=al.joints.Prismatic("x", **{part: self.number}), mass=1.0),)

    for number in (-1.0, al.Uniform(0.5, half_width=0.6)):
        with pytest.raises(al.ProblemError, match=f"expected an? {part} that is not negative; received -"):
            al.Problem(al.ForwardDynamics(Driven(number=number)), grid=al.Grid(1.0, 4), minimize=al.terminal("a").mean)
