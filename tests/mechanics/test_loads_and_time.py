"""External loads, explicit time and parameters that change with time, in all three dynamics, against closed forms."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from double_pendulum import G, simulate
from mujoco_trees import orders, random_tree
from scipy.integrate import solve_ivp

import aleator as al


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


def test_wind_drives_a_cart_as_its_integral_tells():
    found = simulate(al.ForwardDynamics(Cart(wind=GUST)), al.Grid(1.0, 100))
    t = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(found["x_rate"], 3.0 / 2.0 * (1 - np.cos(5 * t)) / 5, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found["x"], 3.0 / 2.0 * (t - np.sin(5 * t) / 5) / 5, rtol=0, atol=1e-8)


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


class Rigged(al.Multibody):
    """The same from bodies: a lift whose motion is prescribed carries the pendulum."""

    actuators = ("lift_torque",)

    def bodies(self):
        return (
            al.Body("lift", joint=al.joints.Prismatic("z"), mass=0.7),
            al.Body("angle", parent="lift", joint=al.joints.Revolute("y"), mass=1.5, center=(0.0, 0.0, -1.0)),
        )


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


def test_a_support_whose_joint_is_prescribed_is_the_same_support():
    motion = {"lift": al.BSpline(al.fit_control_points(0.2 * np.sin(14.0 * np.linspace(0, 1, 400)), 120), degree=3)}
    found = simulate(al.HybridDynamics(Rigged(), motion=motion, start={"angle": 0.6}), al.Grid(2.0, 400))
    np.testing.assert_allclose([-found["angle"][-1], -found["angle_rate"][-1]], -by_scipy(2.0), rtol=0, atol=2e-3)


class Rocket(al.Mechanical):
    """What burns leaves at a velocity of its own: `m v̇` is the thrust (Tsiolkovsky)."""

    names = ("x",)
    burning: al.Number = 0.8

    def mass_matrix(self, q, t):
        return (2.0 - self.burning * t) * jnp.eye(1)

    def load(self, q, v, t):
        return jnp.array([300.0 * self.burning])


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


def test_a_rocket_reaches_the_velocity_of_tsiolkovsky():
    found = simulate(al.ForwardDynamics(Rocket()), al.Grid(1.0, 200))
    np.testing.assert_allclose(found["x_rate"][-1], 300.0 * np.log(2.0 / 1.2), rtol=1e-9)


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


def test_velocities_and_accelerations_follow_a_map_that_changes_with_time():
    steps = 400
    found = simulate(al.InverseDynamics(Turning(size=SIZE), motion={"x": PATH}), al.Grid(1.0, steps))
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
    planned = simulate(al.InverseDynamics(Turning(size=SIZE), motion={"x": PATH}), al.Grid(1.0, 800))
    push = al.Tabulated(np.linspace(0.0, 1.0, 801), planned["push"])
    start = {"x": planned["x"][0], "u": planned["u"][0]}
    driven = simulate(al.ForwardDynamics(Turning(size=SIZE), torque={"push": push}, start=start), grid)
    np.testing.assert_allclose(driven["x"], planned["x"][::8], rtol=0, atol=1e-4)
    np.testing.assert_allclose(driven["x_acceleration"], planned["x_acceleration"][::8], rtol=0, atol=1e-3)


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


def test_forces_on_bodies_are_those_of_mujoco():
    kinds, parents = ["revolute", "prismatic", "ball", "fixed", "revolute"], [-1, 0, 0, 1, 2]
    tree, mj = random_tree(kinds, parents, 3)
    random = np.random.default_rng(7)
    q, v = tree.normalised(jnp.asarray(random.normal(size=mj.nq))), jnp.asarray(random.normal(size=mj.nv))
    given = {body: random.normal(size=6) for body in ("b1", "b2", "b3", "b4")}

    class Pushed(type(tree)):
        def body_loads(self, q, v):
            del q, v
            return tuple(
                al.BodyLoad(name, force=one[:3], moment=one[3:], at=body.center)
                for body in self.given
                for name, one in given.items()
                if name == body.name
            )

    coordinates, speeds = orders(tree, mj)
    data = mujoco.MjData(mj)
    data.qpos[coordinates], data.qvel[speeds] = q, v
    for name, one in given.items():
        data.xfrc_applied[mj.body(name).id] = one  # force and moment at the centre of mass, in the world's axes
    mujoco.mj_forward(mj, data)
    pushed = Pushed(tree.given)
    force = pushed.external(q, v)
    np.testing.assert_allclose(pushed.forward_dynamics(q, v, force), data.qacc[speeds], rtol=0, atol=1e-9)
    back = pushed.inverse_dynamics(q, v, jnp.asarray(data.qacc[speeds])) - force
    np.testing.assert_allclose(back, 0.0, atol=1e-9)
