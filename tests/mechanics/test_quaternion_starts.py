"""Quaternions: starts given in part, prescribed ones that vanish, and hybrid dynamics with some of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import simulate
from scipy.spatial.transform import Rotation

import aleator as al
from compiling import compiled


class Top(al.Multibody):
    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("b", joint=al.joints.Ball(), mass=1.0, inertia=(0.1, 0.2, 0.25)),)


class Flyer(al.Multibody):
    """A free base with an arm, which a motor turns."""

    gravity = (0.0, 0.0, 0.0)
    actuators = ("arm_torque",)

    def bodies(self):
        near = {"position": (0.2, 0.0, 0.1), "center": (0.5, 0.0, 0.1)}
        return (
            al.Body("base", joint=al.joints.Free(), mass=10.0, center=(0.1, 0.05, 0.0), inertia=(1.0, 1.2, 1.4)),
            al.Body("arm", parent="base", joint=al.joints.Revolute("z"), mass=1.0, inertia=(0.1, 0.1, 0.1), **near),
        )


class Swivel(al.Multibody):
    """A head that motors turn on a slide without one."""

    gravity = (0.0, 0.0, 0.0)
    actuators = ("head_omega_x_torque", "head_omega_y_torque", "head_omega_z_torque")

    def bodies(self):
        head = {"mass": 1.0, "center": (0.1, 0.2, 0.3), "inertia": (0.1, 0.1, 0.12)}
        return (
            al.Body("slide", joint=al.joints.Prismatic("x"), mass=2.0),
            al.Body("head", parent="slide", joint=al.joints.Ball(), **head),
        )


def test_components_of_a_quaternion_that_a_start_leaves_out_are_those_of_no_turn():
    start = al.ForwardDynamics(Top(), start={"b_x": 0.05}).initial()["q"]
    np.testing.assert_allclose(start, np.array([1.0, 0.05, 0.0, 0.0]) / np.hypot(1.0, 0.05), rtol=1e-15)
    free = al.HybridDynamics(Flyer(), motion={"arm": 0.3}, start={"base_x": 2.0, "base_qz": 0.05}).initial()["q"]
    np.testing.assert_allclose(free[:3], [2.0, 0.0, 0.0])
    np.testing.assert_allclose(free[3:], np.array([1.0, 0.0, 0.0, 0.05]) / np.hypot(1.0, 0.05), rtol=1e-15)
    half_turn = al.ForwardDynamics(Top(), start={"b_w": 0.0, "b_x": 0.05}).initial()["q"]
    np.testing.assert_allclose(half_turn, [0.0, 1.0, 0.0, 0.0])


def test_a_prescribed_quaternion_that_passes_through_zero_is_refused_with_its_joint_and_time():
    motion = {"b_w": 0.0, "b_x": al.PowerSeries(start=(1.0, 0.0), end=(-1.0, 0.0)), "b_y": 0.0, "b_z": 0.0}
    diagnosis = al.InverseDynamics(Top(), motion=motion).diagnose(al.Grid(1.0, 10))
    assert "quaternion of 'b_w' is zero at t = 0.5 s" in diagnosis
    long = motion | {"b_y": 7.0}
    assert al.InverseDynamics(Top(), motion=long).diagnose(al.Grid(1.0, 10)) == ""
    turned = {name.replace("b_", "head_"): one for name, one in motion.items()}
    assert "'head_w' is zero at t = 0.5 s" in al.HybridDynamics(Swivel(), motion=turned).diagnose(al.Grid(1.0, 10))


@pytest.mark.slow
def test_a_free_base_answers_its_arm_so_that_the_momentum_stays():
    model, grid = Flyer(), al.Grid(1.0, 100)
    swing = al.PowerSeries(start=(0.1, 0.2), end=(1.0, 0.0))
    start = {"base_qx": 0.2, "base_x_rate": 0.1, "base_omega_y": 0.3}
    system = al.HybridDynamics(model, motion={"arm": swing}, start=start, torque_rates=False)
    found = simulate(system, grid)
    np.testing.assert_allclose(found["arm"], swing.values(grid.fractions, 1.0), rtol=1e-13)
    q, v = (jnp.stack([found[name] for name in names], 1) for names in (model.coordinates, model.speeds))
    rates = [name.replace("_rate", "_acceleration") if "_rate" in name else f"{name}_rate" for name in model.speeds]
    v_dot = jnp.stack([found[name] for name in rates], 1)
    force, base, arm = compiled(
        jax.vmap(
            lambda q, v, v_dot: (
                model.inverse_dynamics(q, v, v_dot),
                model.point(q, "base", (0.1, 0.05, 0.0)),
                model.point(q, "arm", (0.5, 0.0, 0.1)),
            )
        )
    )(q, v, v_dot)
    np.testing.assert_allclose(force[:, :6], 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(force[:, 6], found["arm_torque"], rtol=1e-10, atol=1e-12)
    # The centre of mass goes straight on.
    centre = np.asarray(10 * base + arm) / 11
    straight = centre[0] + np.linspace(0, 1, 101)[:, None] * (centre[-1] - centre[0])
    np.testing.assert_allclose(centre, straight, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_prescribed_head_of_any_quaternion_moves_its_slide_back():
    grid = al.Grid(1.0, 100)
    motion = {
        "head_w": al.PowerSeries(start=(1.0, 0.0), end=(2.0, 0.1)),
        "head_x": al.PowerSeries(start=(0.0, 0.3), end=(0.5, 0.0)),
        "head_y": al.PowerSeries(start=(0.3,)),
        "head_z": al.PowerSeries(start=(0.1, 0.3), end=(1.0, 0.0)),
    }
    system = al.HybridDynamics(Swivel(), motion=motion, start={"slide": 0.2})
    assert system.diagnose(grid) == ""
    found = simulate(system, grid)
    raw = np.stack([np.asarray(motion[f"head_{c}"].values(grid.fractions, 1.0)) for c in "wxz"], 1)
    turns = Rotation.from_quat(np.stack([raw[:, 1], np.full(101, 0.3), raw[:, 2], raw[:, 0]], 1))
    reach = turns.apply([0.1, 0.2, 0.3])[:, 0]
    centre = (3 * found["slide"] + reach) / 3
    straight = centre[0] + np.linspace(0, 1, 101) * (centre[-1] - centre[0])
    np.testing.assert_allclose(centre, straight, rtol=0, atol=1e-9)
    assert np.ptp(found["slide"]) > 0.01
    rate, torque = found["head_omega_y_torque_rate"][2:-2], found["head_omega_y_torque"]
    expected = (torque[:-4] - 8 * torque[1:-3] + 8 * torque[3:-1] - torque[4:]) / 0.12
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-4 * np.abs(rate).max())


def test_part_of_a_joint_cannot_be_prescribed():
    with pytest.raises(al.ProblemError, match=r"of the joint of 'base' belong together; received only \['base_x'\]"):
        al.HybridDynamics(Flyer(), motion={"base_x": 0.0})
