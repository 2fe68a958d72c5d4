"""External loads, explicit time and parameters that change with time, in all three dynamics, against closed forms."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import G, simulate
from scipy.integrate import solve_ivp

import aleator as al
from compiling import compiled


class Cart(al.Mechanical):
    """Wind that is given as a parameter pushes a cart."""

    names = ("x",)
    mass: al.Number = 2.0
    wind: al.Number = 0.0

    def mass_matrix(self, q):
        return self.mass * jnp.eye(1)

    def load(self, q, v):
        return jnp.reshape(self.wind, (1,))


GUST = al.processes.signal(lambda t, p: p.high * jnp.sin(p.rate * t), high=3.0, rate=5.0)


def test_torques_of_a_motion_work_against_the_wind_and_so_do_their_rates():
    motion = {"x": al.PowerSeries(start=(0.0, 0.0, 4.0))}  # x = 2 t²
    found = simulate(al.InverseDynamics(Cart(wind=GUST), motion=motion), al.Grid(1.0, 20))
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(found["x_torque"], 2.0 * 4.0 - 3.0 * np.sin(5 * t), rtol=1e-12)
    np.testing.assert_allclose(found["x_torque_rate"], -15.0 * np.cos(5 * t), rtol=1e-11, atol=1e-11)


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


class Lifted(al.Lagrangian):
    """The same, the height being a parameter that changes with time."""

    names = ("angle",)
    height: al.Number = 0.0
    lift: al.Number = 0.0

    def kinetic_energy(self, q, v):
        along, up = jnp.cos(q[0]) * v[0], self.lift + jnp.sin(q[0]) * v[0]
        return 0.5 * 1.5 * (along**2 + up**2)

    def potential_energy(self, q):
        return 1.5 * G * (self.height - jnp.cos(q[0]))


LIFT = al.processes.signal(lambda t, p: 0.2 * jnp.sin(7.0 * t))
SPEED = al.processes.signal(lambda t, p: 1.4 * jnp.cos(7.0 * t))


def by_scipy(t_final):
    """`l φ̈ = -(g + ḧ) sin φ`, the textbook's equation."""

    def rate(t, z):
        return z[1], -(G - 0.2 * 49.0 * np.sin(7.0 * t)) * np.sin(z[0])

    return solve_ivp(rate, (0.0, t_final), (0.6, 0.0), rtol=1e-11, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("model", [Swing(), Lifted(height=LIFT, lift=SPEED)], ids=["time", "parameters"])
def test_a_pendulum_on_a_support_that_oscillates_moves_as_its_equation_says(model):
    found = simulate(al.ForwardDynamics(model, start={"angle": 0.6}), al.Grid(2.0, 400))
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


class Arm(al.Multibody):
    """Two links in the wind, the second of which leaks."""

    wind: al.Number = 0.0
    mass: al.Number = 0.8

    def bodies(self):
        rod = {"center": (0.5, 0.0, 0.0), "inertia": (0.0, 0.1, 0.1)}
        return (
            al.Body("one", joint=al.joints.Revolute("y"), mass=1.0, **rod),
            al.Body(
                "two", parent="one", joint=al.joints.Revolute("y"), position=(1.0, 0.0, 0.0), mass=self.mass, **rod
            ),
        )

    def load(self, q, v, t):
        return jnp.stack([0.3 * jnp.cos(t), -0.1 * v[1]])

    def body_loads(self, q, v):
        drag = -0.4 * self.point_velocity(q, v, "two", (1.0, 0.0, 0.0))
        return (
            al.BodyLoad("two", force=drag + jnp.stack([self.wind, 0.0, 0.0]), at=(1.0, 0.0, 0.0)),
            al.BodyLoad("one", moment=(0.0, 0.5, 0.0)),
        )


class OneMotor(Arm):
    actuators = ("one_torque",)


@pytest.mark.slow
def test_hybrid_dynamics_under_load_moves_as_forward_dynamics_with_the_torque_that_it_found():
    leak = al.processes.signal(lambda t, p: 0.8 - 0.3 * t)
    model = {"wind": GUST, "mass": leak}
    path = {"one": al.BSpline(np.array([0.2, 0.2, 0.5, 0.9, 0.4, 0.4]), degree=4)}
    grid = al.Grid(1.0, 400)
    system = al.HybridDynamics(OneMotor(**model), motion=path, start={"two": 0.3})
    found = simulate(system, grid)
    rate = np.gradient(found["one_torque"], grid.times, edge_order=2)
    np.testing.assert_allclose(found["one_torque_rate"][5:-5], rate[5:-5], rtol=0, atol=2e-2 * np.abs(rate).max())
    torque = al.Tabulated(np.linspace(0.0, 1.0, 401), found["one_torque"])
    start = {"one": found["one"][0], "one_rate": found["one_rate"][0], "two": 0.3}
    driven = simulate(al.ForwardDynamics(OneMotor(**model), torque={"one_torque": torque}, start=start), grid)
    for name in ("one", "two"):
        np.testing.assert_allclose(driven[name], found[name], rtol=0, atol=2e-5)
    # Inverse dynamics of the whole motion needs no torque at the second joint.
    at, q, v, a = 200, *(jnp.array([found[f"{name}{end}"][200] for name in ("one", "two")]) for end in ENDS)
    now = OneMotor(**model).at(grid.times[at])
    needed = now.inverse_dynamics(q, v, a) - now.external(q, v)
    np.testing.assert_allclose(needed, [found["one_torque"][at], 0.0], rtol=0, atol=1e-10)


ENDS = ("", "_rate", "_acceleration")


DRAG, ROTOR = 3.0, 4.0


class Slides(al.Multibody):
    """1 kg on a level slide for each name, with drag in the bias and a rotor in the mass matrix; one motor."""

    gravity = (0.0, 0.0, 0.0)
    named: tuple[str, ...] = eqx.field(static=True, default=("a",))
    actuators = ("a_torque",)

    def bodies(self):
        return tuple(al.Body(name, joint=al.joints.Prismatic("x"), mass=1.0) for name in self.named)

    def bias(self, q, v):
        return super().bias(q, v) + DRAG * v

    def mass_matrix(self, q):
        return super().mass_matrix(q) + ROTOR * jnp.eye(len(self.named))


class Doubled(al.Multibody):
    """Its velocity is half the rate of its coordinate."""

    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("a", joint=al.joints.Prismatic("x"), mass=1.0),)

    def velocity_map(self, q):
        return 2.0 * jnp.eye(1)


def test_what_a_class_adds_to_bias_and_mass_matrix_counts_in_all_three_dynamics():
    grid, motion = al.Grid(1.0, 100), {"a": al.PowerSeries(start=(0.0, 1.0, 1.0))}
    t = np.linspace(0, 1, 101)
    slowing, needed = np.exp(-DRAG / (1 + ROTOR) * t), (1 + ROTOR) + DRAG * (1 + t)
    free = simulate(al.ForwardDynamics(Slides(), start={"a_rate": 1.0}), grid)
    np.testing.assert_allclose(free["a_rate"], slowing, rtol=1e-7)
    planned = simulate(al.InverseDynamics(Slides(), motion=motion), grid)
    np.testing.assert_allclose(planned["a_torque"], needed, rtol=1e-13)
    mixed = simulate(al.HybridDynamics(Slides(named=("a", "b")), motion=motion, start={"b_rate": 1.0}), grid)
    np.testing.assert_allclose(mixed["a_torque"], needed, rtol=1e-13)
    np.testing.assert_allclose(mixed["b_rate"], slowing, rtol=1e-7)


def test_a_velocity_map_of_one_s_own_makes_the_rates():
    assert not Doubled().moves_directly
    found = simulate(al.ForwardDynamics(Doubled(), start={"a_rate": 1.0}), al.Grid(1.0, 4))
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
