"""A free rigid body as a mechanical system of one's own: by Euler angles, and by quaternions."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import simulate
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import aleator as al
from compiling import compiled

INERTIA = np.array([0.5, 1.1, 1.7])
SPIN = np.array([0.9, 2.1, -0.6])
TILT = Rotation.from_euler("ZYX", [0.4, -0.3, 0.7])
GRID = al.Grid(1.0, 500)
BODY = ("body_x", "body_y", "body_z")


class Body(al.Mechanical):
    """Euler's equations in the body's axes, whatever the coordinates are."""

    velocity_names = BODY
    actuator_names = ("couple_x", "couple_y", "couple_z")

    inertia: al.Number = (0.5, 1.1, 1.7)

    def mass_matrix(self, q):
        return jnp.diag(jnp.array(self.inertia))

    def forces(self, q, v):
        return jnp.cross(v, jnp.array(self.inertia) * v)

    def actuation(self, q):
        return jnp.eye(3)


class Angles(Body):
    """Yaw, pitch and roll about turning axes."""

    names = ("yaw", "pitch", "roll")

    def velocity_map(self, q):
        sin, cos, tan = jnp.sin(q[2]), jnp.cos(q[2]), jnp.tan(q[1])
        return jnp.array(
            [[0.0, sin / jnp.cos(q[1]), cos / jnp.cos(q[1])], [0.0, cos, -sin], [1.0, sin * tan, cos * tan]]
        )


class Quaternion(Body):
    """Of length one, its real part first."""

    names = ("w", "x", "y", "z")

    def velocity_map(self, q):
        w, x, y, z = q
        return 0.5 * jnp.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])

    def normalised(self, q):
        return q / jnp.linalg.norm(q)


@cache
def by_scipy():
    """Euler's equations of a body without torque: the spin in its axes at each instant."""

    def rates(t, v):
        return -np.cross(v, INERTIA * v) / INERTIA

    return solve_ivp(rates, (0, 1), SPIN, method="DOP853", rtol=1e-12, atol=1e-12, t_eval=GRID.fractions).y.T


@cache
def tumbling(model):
    spins = dict(zip(BODY, SPIN, strict=True))
    if model is Angles:
        start = dict(zip(Angles.names, TILT.as_euler("ZYX"), strict=True))
    else:
        start = dict(zip(Quaternion.names, 2.5 * TILT.as_quat(scalar_first=True), strict=True))
    return simulate(al.ForwardDynamics(model(), start=start | spins), GRID)


def rotations(found, model):
    columns = np.stack([found[name] for name in model.names], axis=1)
    return Rotation.from_euler("ZYX", columns) if model is Angles else Rotation.from_quat(columns, scalar_first=True)


@pytest.mark.parametrize("model", [Angles, Quaternion])
def test_a_body_without_torque_spins_by_euler_s_equations(model):
    found = tumbling(model)
    spin = np.stack([found[name] for name in BODY], axis=1)
    np.testing.assert_allclose(spin, by_scipy(), rtol=0, atol=1e-8)
    assert np.ptp(spin, axis=0).min() > 0.1
    momentum = rotations(found, model).apply(INERTIA * spin)
    np.testing.assert_allclose(momentum, np.tile(TILT.apply(INERTIA * SPIN), (501, 1)), rtol=0, atol=1e-8)
    energy = (INERTIA * spin**2).sum(axis=1) / 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_angles_and_quaternions_give_the_same_rotation():
    both = [rotations(tumbling(model), model) for model in (Angles, Quaternion)]
    apart = (both[0].inv() * both[1]).magnitude()
    assert apart.max() < 1e-8
    assert (both[0][0].inv() * both[0][-1]).magnitude() > 0.5


def test_quaternions_are_of_length_one_in_outputs_and_their_rates_along_the_sphere():
    found = tumbling(Quaternion)
    q, q_dot, q_ddot = (np.stack([found[name + end] for name in "wxyz"], 1) for end in ("", "_rate", "_acceleration"))
    np.testing.assert_allclose((q**2).sum(axis=1), 1.0, rtol=1e-13)
    np.testing.assert_allclose((q * q_dot).sum(axis=1), 0.0, rtol=0, atol=1e-13)
    np.testing.assert_allclose((q * q_ddot + q_dot**2).sum(axis=1), 0.0, rtol=0, atol=1e-12)
    h = 1 / 500
    np.testing.assert_allclose(q_dot[1:-1], (q[2:] - q[:-2]) / (2 * h), rtol=0, atol=1e-4)
    np.testing.assert_allclose(q_ddot[1:-1], (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2, rtol=0, atol=1e-4)


def wave(joints, seed):
    points = 0.4 * np.random.default_rng(seed).normal(size=(8, joints))
    return al.BSpline(points + np.eye(joints)[0], degree=5)


@pytest.mark.parametrize("model", [Angles, Quaternion])
def test_velocities_of_a_prescribed_motion_are_those_of_its_rotation(model):
    n = len(model.names)
    grid = al.Grid(2.0, 2000)
    found = simulate(al.InverseDynamics(model(), motion=wave(n, n)), grid)
    turned, h = rotations(found, model), 1e-3
    spin = np.stack([found[name] for name in BODY], axis=1)
    # Turns from each instant to both beside it, in its own axes.
    ahead, behind = ((turned[1:-1].inv() * one).as_rotvec() for one in (turned[2:], turned[:-2]))
    np.testing.assert_allclose(spin[1:-1], (ahead - behind) / (2 * h), rtol=0, atol=5e-5 * np.abs(spin).max())
    rate = np.stack([found[f"{name}_rate"] for name in BODY], axis=1)
    slope = (spin[2:] - spin[:-2]) / (2 * h)
    np.testing.assert_allclose(rate[1:-1], slope, rtol=0, atol=1e-4 * np.abs(rate).max())
    torque = np.stack([found[f"couple_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(torque, INERTIA * rate + np.cross(spin, INERTIA * spin), rtol=1e-9, atol=1e-9)
    torque_rate = np.stack([found[f"couple_{axis}_rate"] for axis in "xyz"], axis=1)[1:-1]
    slope = (torque[2:] - torque[:-2]) / (2 * h)
    np.testing.assert_allclose(torque_rate, slope, rtol=0, atol=1e-3 * np.abs(torque_rate).max())


def test_velocities_of_prescribed_angles_solve_equations_66_and_67():
    grid, motion = al.Grid(2.0, 40), wave(3, 3)
    found = simulate(al.InverseDynamics(Angles(), motion=motion), grid)
    q, q_dot, q_ddot = (np.asarray(motion.values(grid.fractions, 2.0, order)) for order in range(3))
    v, v_dot = (np.stack([found[name + end] for name in BODY], axis=1) for end in ("", "_rate"))
    H = np.asarray(compiled(jax.vmap(Angles().velocity_map))(q))
    h = 1e-6
    ahead, behind = (np.asarray(compiled(jax.vmap(Angles().velocity_map))(q + s * h * q_dot)) for s in (1, -1))
    change = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(np.einsum("tij,tj->ti", H, v), q_dot, rtol=1e-9, atol=1e-9)
    expected = np.einsum("tij,tj->ti", H, v_dot) + np.einsum("tij,tj->ti", change, v)
    np.testing.assert_allclose(expected, q_ddot, rtol=1e-5, atol=1e-5)


def test_inverse_dynamics_of_a_tumbling_body_takes_no_torque():
    # Three conditions at the end and all at the start: a polynomial that touches the free motion at its start.
    found = tumbling(Angles)
    start = tuple(np.array([found[name + end][0] for name in Angles.names]) for end in ("", "_rate", "_acceleration"))
    touching = simulate(al.InverseDynamics(Angles(), motion=al.PowerSeries(start=start)), al.Grid(1.0, 4))
    np.testing.assert_allclose([touching[f"couple_{axis}"][0] for axis in "xyz"], 0.0, rtol=0, atol=1e-12)
    assert abs(touching["couple_x"][-1]) > 1e-3


def test_gimbal_lock_is_refused_with_its_angle_and_time():
    through = al.PowerSeries(start=(np.array([0.1, 0.0, 0.2]),), end=(np.array([0.1, np.pi, 0.2]),))
    with pytest.raises(al.ProblemError, match=r"singular at t = 0\.5 s .*pitch = 1\.571.*rate of '(yaw|roll)'.*gimbal"):
        al.Problem(
            al.InverseDynamics(Angles(inertia=(0.5, 1.1, al.Decision(1.7, 1.0, 2.0))), motion=through),
            grid=al.Grid(1.0, 10),
            minimize=al.objectives.effort("couple_x"),
        )


def test_some_angles_of_a_body_alone_cannot_be_prescribed():
    system = al.HybridDynamics(Angles(), motion={"yaw": al.PowerSeries(start=(0.1, 1.0))})
    assert "enter the rates of the prescribed ones (yaw)" in system.diagnose(al.Grid(1.0, 10))


def test_body_rates_that_pass_for_rates_of_angles_are_refused():
    class Misnamed(Angles):
        velocity_names = None

    diagnosis = al.ForwardDynamics(Misnamed()).diagnose(al.Grid(1.0, 10))
    assert "the velocity 'yaw_rate' is named as the rate of 'yaw'" in diagnosis
    assert "velocity_names" in diagnosis


def test_hybrid_dynamics_needs_one_velocity_for_each_coordinate():
    with pytest.raises(al.ProblemError, match="received 4 coordinates and 3 velocities"):
        al.HybridDynamics(Quaternion(), motion={"w": 1.0})
