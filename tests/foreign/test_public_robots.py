"""Robots that other packages ship, by aleator and by MuJoCo's C library."""

import warnings

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco_robots import assert_same, by_aleator, by_mujoco, file_of, orders, states, urdf_by_mujoco

import aleator as al

# The file, and the effects that a tree of bodies has no place for.
URDF = {
    "UR5e": ("arms/ur5e/ur5e.urdf", ()),
    "gripper": ("grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf", ("mimic",)),
}
MJCF = {
    "swimmer": ("swimmer.xml", ("fluid",)),
    "double pendulum": ("inverted_double_pendulum.xml", ()),
    "cheetah": ("half_cheetah.xml", ()),
    "ant": ("ant.xml", ()),
    "humanoid": ("humanoid.xml", ()),
}
CASES = [pytest.param(name, marks=[] if name == "double pendulum" else [pytest.mark.slow]) for name in (*URDF, *MJCF)]
STATES = 3


def read(name):
    """A robot by aleator and by MuJoCo."""
    if name in URDF:
        path, left_out = URDF[name]
        file = file_of("airo_models", path)
        return al.foreign.read_urdf(file, leave_out=left_out), urdf_by_mujoco(file.read_text())
    path, left_out = MJCF[name]
    file = file_of("gymnasium", f"envs/mujoco/assets/{path}")
    model = mujoco.MjSpec.from_file(str(file))
    model.option.density = model.option.viscosity = 0
    with warnings.catch_warnings():
        # One file asks for a total mass in a way that newer versions warn of.
        warnings.simplefilter("ignore")
        model = model.compile()
    return al.foreign.read_mjcf(file, leave_out=left_out), model


@pytest.mark.parametrize("name", CASES)
def test_mass_matrix_bias_and_gravity_of_public_robots_are_those_of_mujoco(name):
    robot, model = read(name)
    at = states(robot, STATES, seed=7)
    assert_same(by_aleator(robot, *at), by_mujoco(model, robot, *at))


def test_links_are_where_mujoco_puts_them():
    robot, model = read("ant")
    q = states(robot, 1, seed=9)[0][0]
    data = mujoco.MjData(model)
    data.qpos[orders(model, robot)[0]] = q
    mujoco.mj_kinematics(model, data)
    poses = robot.poses(jnp.asarray(q))
    for body in range(1, model.nbody):
        pose = poses[model.body(body).name or f"body_{body}"]
        np.testing.assert_allclose(pose.position, data.xpos[body], rtol=0, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, data.xmat[body].reshape(3, 3), rtol=0, atol=1e-12)
