"""A pendulum in either format of robots moves, and changes with its mass, as by SciPy.

A uniform rod of 1 kg and 1 m, hinged at its end, with viscous
damping of 0.1 N·m·s/rad, under gravity of 9.81 m/s². The hinge is about y; at zero the rod hangs.
"""

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled

URDF = """<?xml version="1.0"?>
<robot name="pendulum">
  <link name="ground"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5"/>
      <mass value="1.0"/>
      <inertia ixx="0.08333333333333333" iyy="0.08333333333333333" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><mesh filename="package://nowhere/rod.dae"/></geometry></visual>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="ground"/>
    <child link="rod"/>
    <axis xyz="0 1 0"/>
    <dynamics damping="0.1"/>
  </joint>
</robot>
"""

MJCF = """<mujoco>
  <asset><mesh name="rod" file="nowhere.stl"/></asset>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <inertial pos="0 0 -0.5" mass="1.0" diaginertia="0.08333333333333333 0.08333333333333333 1e-12"/>
      <geom type="mesh" mesh="rod"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.slow
@pytest.mark.parametrize(("read", "text"), [(al.foreign.read_mjcf, MJCF), (al.foreign.read_urdf, URDF)])
def test_the_motion_of_a_pendulum_and_its_derivative_by_the_mass_are_those_of_scipy(tmp_path, read, text):
    (tmp_path / "pendulum.xml").write_text(text)
    robot = read(tmp_path / "pendulum.xml")

    def angle(mass):
        model = eqx.tree_at(lambda robot: robot.parts["rod"].mass, robot, mass)
        return al.simulate(al.ForwardDynamics(model, start={"hinge": 1.0}), al.Grid(1.0, 200), only=["hinge"])["hinge"]

    found, slope = compiled(lambda mass: (angle(mass), jax.jacfwd(angle)(mass)))(1.0)
    np.testing.assert_allclose(found, by_scipy(1.0), rtol=0, atol=1e-8)
    differences = (by_scipy(1.0 + 1e-4) - by_scipy(1.0 - 1e-4)) / 2e-4
    np.testing.assert_allclose(slope, differences, rtol=0, atol=1e-6)


def by_scipy(mass):
    """The angle of a pendulum whose mass alone changes, with the moment of inertia about its centre."""

    def rates(t, z):
        return z[1], -(0.5 * 9.81 * mass * np.sin(z[0]) + 0.1 * z[1]) / (1 / 12 + mass / 4)

    instants = np.linspace(0.0, 1.0, 201)
    return solve_ivp(rates, (0.0, 1.0), (1.0, 0.0), "DOP853", instants, rtol=1e-12, atol=1e-12).y[0]
