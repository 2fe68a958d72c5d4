"""A pendulum in either format of robots moves, and changes with its mass, as by SciPy."""

import equinox as eqx
import jax
import numpy as np
import pytest
from robot_pendulums import MJCF, URDF
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled


@pytest.mark.parametrize(("read", "text"), [(al.foreign.read_urdf, URDF), (al.foreign.read_mjcf, MJCF)])
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
