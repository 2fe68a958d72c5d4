"""The pendulum on which every foreign format is checked, against the same one in our own words and against SciPy."""

import functools
from functools import partial

import equinox as eqx
import jax
import numpy as np
import pytest
from robot_pendulums import GRID, MJCF, START, URDF, Pendulum
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    (folder / "pendulum.urdf").write_text(URDF)
    (folder / "pendulum.xml").write_text(MJCF)
    return {
        "urdf": al.foreign.read_urdf(folder / "pendulum.urdf"),
        "mjcf": al.foreign.read_mjcf(folder / "pendulum.xml"),
    }


def motion(model):
    return al.simulate(al.ForwardDynamics(model, start=START), GRID, only=["hinge", "hinge_rate"])


def with_mass(robot, mass):
    return eqx.tree_at(lambda robot: robot.parts["rod"].mass, robot, mass)


def with_slope(model):
    """The motion, and how it changes with the mass, at 1 kg."""
    found = compiled(lambda mass: (motion(model(mass)), jax.jacfwd(lambda mass: motion(model(mass)))(mass)))(1.0)
    return jax.tree.map(np.asarray, found)


@functools.cache
def own():
    return with_slope(Pendulum)


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_the_motion_and_its_derivatives_are_those_of_the_same_pendulum_in_our_own_words(robots, form):
    found, slopes = with_slope(partial(with_mass, robots[form]))
    for ours, expected in zip((found, slopes), own(), strict=True):
        for name in ("hinge", "hinge_rate"):
            np.testing.assert_allclose(ours[name], expected[name], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["hinge"], by_scipy(1.0), rtol=0, atol=1e-8)
    differences = (by_scipy(1.0 + 1e-4) - by_scipy(1.0 - 1e-4)) / 2e-4
    np.testing.assert_allclose(slopes["hinge"], differences, rtol=0, atol=1e-6)


def by_scipy(mass):
    """The angle of a pendulum whose mass alone changes, with the moment of inertia about its centre."""

    def rates(t, z):
        return z[1], -(0.5 * 9.81 * mass * np.sin(z[0]) + 0.1 * z[1]) / (1 / 12 + mass / 4)

    instants = np.linspace(0.0, 1.0, 201)
    return solve_ivp(rates, (0.0, 1.0), (1.0, 0.0), "DOP853", instants, rtol=1e-12, atol=1e-12).y[0]
