"""External loads, explicit time and parameters that change with time, in all three dynamics, against closed forms."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from double_pendulum import G, simulate
from scipy.integrate import solve_ivp

import aleator as al
from zoo import Cart

GUST = al.processes.signal(lambda t, p: p.high * jnp.sin(p.rate * t), high=3.0, rate=5.0)


def test_torques_of_a_motion_work_against_the_wind_and_so_do_their_rates():
    motion = {"x": al.PowerSeries(start=(0.0, 0.0, 4.0))}  # x = 2 t²
    found = simulate(al.InverseDynamics(Cart(wind=GUST), motion=motion), al.Grid(1.0, 20))
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(found["x_torque"], 2.0 * 4.0 - 3.0 * np.sin(5 * t), rtol=1e-12)
    np.testing.assert_allclose(found["x_torque_rate"], -15.0 * np.cos(5 * t), rtol=1e-11, atol=1e-11)


def test_one_signal_drives_a_single_actuator():
    found = simulate(al.ForwardDynamics(Cart(), torque=al.Tabulated([0.0, 1.0], [1.0, 1.0])), al.Grid(1.0, 4))
    np.testing.assert_allclose(found["x"], 0.25 * np.linspace(0, 1, 5) ** 2, rtol=1e-13, atol=1e-15)


class Swing(al.Lagrangian):
    """A pendulum whose support goes up and down, told by the time itself."""

    names = ("angle",)
    high: al.Number = 0.2
    rate: al.Number = 7.0

    def height(self, t):
        return self.high * jnp.sin(self.rate * t)

    def bob(self, q, t):
        return jnp.stack([jnp.sin(q[0]), self.height(t) - jnp.cos(q[0])])

    def kinetic_energy(self, q, v, t):
        velocity = jax.jvp(self.bob, (q, t), (v, jnp.ones_like(t)))[1]
        return 0.5 * 1.5 * velocity @ velocity

    def potential_energy(self, q, t):
        return 1.5 * G * self.bob(q, t)[1]


def by_scipy(t_final):
    """`l φ̈ = -(g + ḧ) sin φ`, the textbook's equation."""

    def rate(t, z):
        return z[1], -(G - 0.2 * 49.0 * np.sin(7.0 * t)) * np.sin(z[0])

    return solve_ivp(rate, (0.0, t_final), (0.6, 0.0), rtol=1e-11, atol=1e-12).y[:, -1]


def test_a_pendulum_on_a_support_that_oscillates_moves_as_its_equation_says():
    found = simulate(al.ForwardDynamics(Swing(), start={"angle": 0.6}), al.Grid(2.0, 400))
    np.testing.assert_allclose([found["angle"][-1], found["angle_rate"][-1]], by_scipy(2.0), rtol=0, atol=1e-6)


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


def test_what_inverse_dynamics_finds_moves_the_system_forward_on_the_same_path():
    grid = al.Grid(1.0, 100)
    found = planned()
    push = al.Tabulated(np.linspace(0.0, 1.0, 801), found["push"])
    start = {"x": found["x"][0], "u": found["u"][0]}
    driven = simulate(al.ForwardDynamics(Turning(size=SIZE), torque={"push": push}, start=start), grid)
    np.testing.assert_allclose(driven["x"], found["x"][::8], rtol=0, atol=1e-4)
    np.testing.assert_allclose(driven["x_acceleration"], found["x_acceleration"][::8], rtol=0, atol=1e-3)


DRAG, ROTOR, WIND = 3.0, 4.0, 2.0


class Slides(al.Multibody):
    """1 kg in the wind on a level slide for each name, with drag in the bias and a rotor in the mass matrix."""

    gravity = (0.0, 0.0, 0.0)
    named: tuple[str, ...] = eqx.field(static=True, default=("a",))
    actuators = ("a_torque",)

    def bodies(self):
        return tuple(al.Body(name, joint=al.joints.Prismatic("x"), mass=1.0) for name in self.named)

    def bias(self, q, v):
        return super().bias(q, v) + DRAG * v

    def mass_matrix(self, q):
        return super().mass_matrix(q) + ROTOR * jnp.eye(len(self.named))

    def body_loads(self, q, v):
        return tuple(al.BodyLoad(name, force=(WIND, 0.0, 0.0)) for name in self.named)


def test_what_a_class_adds_to_bias_and_mass_matrix_counts_where_motions_are_prescribed_and_where_they_are_not():
    grid, motion = al.Grid(1.0, 100), {"a": al.PowerSeries(start=(0.0, 1.0, 1.0))}
    t = np.linspace(0, 1, 101)
    slowing = WIND / DRAG + (1 - WIND / DRAG) * np.exp(-DRAG / (1 + ROTOR) * t)
    needed = (1 + ROTOR) + DRAG * (1 + t) - WIND
    mixed = simulate(al.HybridDynamics(Slides(named=("a", "b")), motion=motion, start={"b_rate": 1.0}), grid)
    np.testing.assert_allclose(mixed["a_torque"], needed, rtol=1e-13)
    np.testing.assert_allclose(mixed["b_rate"], slowing, rtol=1e-7)
