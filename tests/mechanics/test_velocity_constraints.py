"""Edges and wheels, which bind velocities but no coordinates, against closed forms: forward, inverse and hybrid."""

import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import G, simulate

import aleator as al
from zoo import cases

SPIN, SLOPE = 2.0, 0.3


class Edge(al.Lagrangian):
    """A knife edge on an incline: a body that does not move across its heading."""

    names = ("x", "y", "heading")
    velocity_constraint_names = ("edge",)
    slope: al.Number = SLOPE

    def kinetic_energy(self, q, v):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + 0.1 * v[2] ** 2)

    def potential_energy(self, q):
        return -G * jnp.sin(self.slope) * q[0]

    def velocity_constraint(self, q, v):
        return (v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2]),)


TURNING = al.PowerSeries(start=(0.0, SPIN), end=(2.0 * SPIN, SPIN))
STATES = {
    "forward": al.ForwardDynamics(Edge(), start={"heading_rate": SPIN}),
    "hybrid": al.HybridDynamics(Edge(), motion={"heading": TURNING}, torque={"x_torque": 0.0, "y_torque": 0.0}),
}


@pytest.mark.parametrize("kind", cases(STATES))
def test_a_knife_edge_slides_down_and_up_the_incline_again(kind):
    found = simulate(STATES[kind], al.Grid(2.0, 400))
    turned, pull = SPIN * np.linspace(0.0, 2.0, 401), G * np.sin(SLOPE)
    np.testing.assert_allclose(found["x"], pull / (2 * SPIN**2) * np.sin(turned) ** 2, rtol=0, atol=1e-9)
    along = pull / (2 * SPIN**2) * (turned - np.sin(2 * turned) / 2)
    np.testing.assert_allclose(found["y"], along, rtol=0, atol=1e-9)
    # The force across the edge, from the acceleration along x.
    np.testing.assert_allclose(found["edge_multiplier"], 2 * pull * np.sin(turned), rtol=0, atol=1e-8)
    assert found["constraint_rate_error"].max() < 1e-14


MASS, INERTIA, ABOUT, RADIUS = 2.0, 0.3, 0.2, 0.4


class Disk(al.Mechanical):
    """An upright disk that rolls on a plane and may be steered."""

    names = ("x", "y", "heading", "turn")
    actuator_names = ("heading_torque", "turn_torque")
    velocity_constraint_names = ("rolling", "sliding")

    def mass_matrix(self, q):
        return jnp.diag(jnp.array([MASS, MASS, ABOUT, INERTIA]))

    def velocity_constraint(self, q, v):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return c * v[0] + s * v[1] - RADIUS * v[3], c * v[1] - s * v[0]


ROLLED, REST = al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0)), al.PowerSeries(start=(0.0, 0.0), end=(0.0, 0.0))
STRAIGHT = {
    "x": al.PowerSeries(start=(0.0, 0.0), end=(RADIUS, 0.0)),
    "y": REST,
    "heading": REST,
    "turn": ROLLED,
}


@pytest.mark.parametrize("count", cases([4, 2]))
def test_prescribed_coordinates_may_be_all_those_that_obey_the_constraints(count):
    names = {2: ("heading", "turn"), 4: Disk.names}[count]
    system = al.InverseDynamics(Disk(), motion={name: STRAIGHT[name] for name in names})
    found = simulate(system, al.Grid(1.0, 8))
    angular = 6.0 - 12.0 * np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(found["turn_torque"], (INERTIA + MASS * RADIUS**2) * angular, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["rolling_multiplier"], -MASS * RADIUS * angular, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["heading_torque"], 0.0, rtol=0, atol=1e-9)
    rate = -12.0 * (INERTIA + MASS * RADIUS**2)
    np.testing.assert_allclose(found["turn_torque_rate"], rate, rtol=1e-8)


class Belt(al.Mechanical):
    """A disk on a belt that gains speed."""

    names = ("x", "turn")
    velocity_constraint_names = ("grip",)
    gain: al.Number = 0.7

    def mass_matrix(self, q):
        return jnp.diag(jnp.array([MASS, INERTIA]))

    def velocity_constraint(self, q, v, t):
        return (v[0] - RADIUS * v[1] - self.gain * t,)


def test_a_belt_that_gains_speed_takes_a_disk_along():
    found = simulate(al.ForwardDynamics(Belt()), al.Grid(2.0, 20))
    force = 0.7 / (1 / MASS + RADIUS**2 / INERTIA)
    np.testing.assert_allclose(found["grip_multiplier"], -force, rtol=1e-12)
    np.testing.assert_allclose(found["x"], force / MASS * np.linspace(0.0, 2.0, 21) ** 2 / 2, rtol=1e-12)


KICK = {"kick": al.Event(lambda self, t, z: t - 0.5, jump=lambda self, t, z: {"v": z.v.at[self.along].add(1.0)})}


class KickedBelt(Belt):
    """The same; the disk is kicked along x."""

    along = 0
    events = KICK


@pytest.mark.slow
def test_a_kick_is_shared_by_what_a_constraint_couples_as_an_impulse_of_it_does():
    # The impulse at the rim takes from the speed what it adds to the turning.
    found = simulate(al.ForwardDynamics(KickedBelt()), al.Grid(2.0, 20))
    force, share = 0.7 / (1 / MASS + RADIUS**2 / INERTIA), MASS / (MASS + INERTIA / RADIUS**2)
    assert found["x"][-1] == pytest.approx(force / MASS * 2.0 + share * 1.5, rel=1e-12)


def with_equation(equation):
    return type("Odd", (Edge,), {"velocity_constraint": lambda self, q, v: (equation(q, v),)})()


def forward(model, **start):
    return al.ForwardDynamics(model, start=start)


LINEAR = ["Odd.velocity_constraint(q, v): expected equations that are linear in the velocities", "constraint(q)"]
GRID = al.Grid(1.0, 4)
REFUSED = {
    "no velocity": (lambda: forward(with_equation(lambda q, v: q[0] - 1.0), heading_rate=1.0), LINEAR),
    "all velocities that slip": (
        lambda: forward(Edge(), x_rate=1.0, y_rate=0.5, heading_rate=0.0),
        ["names all velocities, and contradicts its constraints", "missed by edge = -0.5"],
    ),
    "a motion that slips": (
        lambda: al.InverseDynamics(Edge(), motion={"x": REST, "y": ROLLED, "heading": REST}),
        ["prescribed for 'x', 'y', 'heading'", "at t = 0.5 s it misses what 'edge' asks of the velocities by 1.5"],
    ),
    "a guess": (
        lambda: al.ForwardDynamics(Edge(), guess={"x": 1.0}),
        ["expected no guess, for no constraint binds coordinates"],
    ),
    "too few coordinates": (
        lambda: al.InverseDynamics(Edge(), motion={"x": REST}),
        ["for 2 of ['x', 'y', 'heading']", "or for up to 3 that obey its velocity constraints"],
    ),
}


# What diagnosis compiles takes long.
COMPILED = ("all velocities that slip", "a motion that slips")


@pytest.mark.parametrize("case", [pytest.param(one, marks=[pytest.mark.slow] * (one in COMPILED)) for one in REFUSED])
def test_is_refused_in_words(case):
    make, parts = REFUSED[case]
    with pytest.raises(al.ProblemError) as caught:
        al.Problem(make(), grid=GRID, minimize=al.terminal("x").mean)
    for part in parts:
        assert part in str(caught.value)
