"""External loads and parameters that change with time, against closed forms."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import simulate

import aleator as al
from zoo import Cart

GUST = al.processes.signal(lambda t, p: p.high * jnp.sin(p.rate * t), high=3.0, rate=5.0)


def test_torques_of_a_motion_work_against_the_wind_and_so_do_their_rates():
    motion = {"x": al.PowerSeries(start=(0.0, 0.0, 4.0))}  # x = 2 t²
    found = simulate(al.InverseDynamics(Cart(wind=GUST), motion=motion), al.Grid(1.0, 20))
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(found["x_torque"], 2.0 * 4.0 - 3.0 * np.sin(5 * t), rtol=1e-12)
    np.testing.assert_allclose(found["x_torque_rate"], -15.0 * np.cos(5 * t), rtol=1e-11, atol=1e-11)


def test_a_table_in_a_model_is_a_force_over_time_also_where_it_is_uncertain():
    table = al.Tabulated([0.0, 1.0], [al.Normal(2.0, 0.1), 4.0])
    system = al.InverseDynamics(Cart(wind=table), motion={"x": al.PowerSeries(start=(0.0, 0.0, 4.0))})
    torque = al.expand(lambda one: al.simulate(one, al.Grid(1.0, 20))["x_torque"], system, al.Expansion(order=1))
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(torque.mean, 8.0 - (2.0 + 2.0 * t), rtol=1e-12)
    np.testing.assert_allclose(torque.std, 0.1 * (1.0 - t), atol=1e-12)


class Drone(al.Multibody):
    """A body that moves freely, pushed by a wind that is given or, for `None`, the sine of the time."""

    wind: al.Number = None
    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("b", joint=al.joints.Free(), mass=2.0, inertia=(1.0, 2.0, 2.5)),)

    def body_loads(self, q, v, t):
        along = jnp.sin(t) if self.wind is None else self.wind
        return (al.BodyLoad("b", force=along * jnp.array([1.0, 0.0, 0.0])),)


TABLE = al.Tabulated([0.0, 1.0], [0.0, 1.0])


@pytest.mark.parametrize(("wind", "place"), [(None, (1 - np.sin(1.0)) / 2), (TABLE, 1 / 12)])
def test_loads_on_a_free_body_may_follow_the_time_or_a_table(wind, place):
    found = simulate(al.ForwardDynamics(Drone(wind=wind)), al.Grid(1.0, 20))
    assert found["b_x"][-1] == pytest.approx(place, rel=1e-7)


class Leaking(al.Multibody):
    """Sand runs out of a cart that nothing pushes."""

    mass: al.Number = 1.0
    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("x", joint=al.joints.Prismatic("x"), mass=self.mass),)


class Gathering(al.Lagrangian):
    """Sand that was at rest falls into a cart that nothing pushes."""

    names = ("x",)
    mass: al.Number = 1.0

    def kinetic_energy(self, q, v):
        return 0.5 * self.mass * v @ v


MASS = al.processes.signal(lambda t, p: p.first + p.flow * t, first=2.0, flow=1.5)


@pytest.mark.slow
def test_changing_masses_keep_velocity_in_newton_s_equations_and_momentum_in_lagrange_s():
    start, grid = {"x_rate": 3.0}, al.Grid(1.0, 100)
    leaking = simulate(al.ForwardDynamics(Leaking(mass=MASS), start=start), grid)
    np.testing.assert_allclose(leaking["x_rate"], 3.0, rtol=1e-14)
    gathering = simulate(al.ForwardDynamics(Gathering(mass=MASS), start=start), grid)
    np.testing.assert_allclose(gathering["x_rate"], 6.0 / (2.0 + 1.5 * np.linspace(0, 1, 101)), rtol=1e-8)


class Turning(al.Mechanical):
    """Its velocity is scaled by a map that depends on coordinate, time and a parameter: equations (65) to (67)."""

    names = ("x",)
    velocity_names = ("u",)
    actuator_names = ("push",)
    size: al.Number = 1.0

    def mass_matrix(self, q, t):
        return jnp.reshape(2.0 + jnp.sin(t) + q[0] ** 2, (1, 1))

    def velocity_map(self, q, t):
        return jnp.reshape((1.5 + 0.3 * jnp.sin(q[0])) * self.size * jnp.exp(-0.4 * t), (1, 1))

    def actuation(self, q):
        return jnp.ones((1, 1))

    def load(self, q, v, t):
        return jnp.sin(3.0 * q + t) - 0.2 * v


SIZE = al.processes.signal(lambda t, p: 1.2 + 0.5 * jnp.sin(2.0 * t))
PATH = al.BSpline(np.array([0.1, -0.4, 0.9, 0.3, 0.2, -0.5, 0.4, 0.6]), degree=5)


@cache
def planned():
    return simulate(al.InverseDynamics(Turning(size=SIZE), motion={"x": PATH}), al.Grid(1.0, 800))


def test_velocities_and_accelerations_follow_a_map_that_changes_with_time():
    steps, found = 800, planned()
    t = np.linspace(0.0, 1.0, steps + 1)
    H = (1.5 + 0.3 * np.sin(found["x"])) * (1.2 + 0.5 * np.sin(2 * t)) * np.exp(-0.4 * t)
    np.testing.assert_allclose(found["u"], found["x_rate"] / H, rtol=1e-12)
    h = 1.0 / steps
    for rate, value in (("u_rate", "u"), ("push_rate", "push")):
        expected = (found[value][2:] - found[value][:-2]) / (2 * h)
        np.testing.assert_allclose(found[rate][1:-1], expected, rtol=0, atol=5e-4 * np.abs(expected).max())
    balance = (2 + np.sin(t) + found["x"] ** 2) * found["u_rate"] - np.sin(3 * found["x"] + t) + 0.2 * found["u"]
    np.testing.assert_allclose(found["push"], balance, rtol=1e-11, atol=1e-11)
