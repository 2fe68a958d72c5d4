"""Equations of motion of SymPy, by Kane's method against our own bodies and joints, by Lagrange's with constraints."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al
from compiling import compiled

M, L, D, G = sp.symbols("m l d g")
A, B, U_A, U_B, T_A, T_B = me.dynamicsymbols("a b u_a u_b t_a t_b")
M_1, M_2, L_1, L_2 = sp.symbols("m_1 m_2 l_1 l_2")
RODS = {M_1: 1.3, M_2: 0.8, L_1: 0.9, L_2: 0.6, D: 0.15, G: 9.81}


def rod_on(name, frame, pin, mass, length):
    """A uniform rod along the first axis of its frame, from a pin; and its end."""
    center, end = pin.locatenew(f"{name}_center", length / 2 * frame.x), pin.locatenew(f"{name}_end", length * frame.x)
    for point in (center, end):
        point.v2pt_theory(pin, WORLD, frame)
    inertia = me.inertia(frame, 0, 0, mass * length**2 / 12)
    return me.RigidBody(name, center, frame, mass, (inertia, center)), end


WORLD = me.ReferenceFrame("N")


def hinge():
    pin = me.Point("O")
    pin.set_vel(WORLD, 0)
    return pin


@cache
def rods_by_kane(absolute=False):
    """Two rods in a row, with damping and a torque in each joint; the second angle is measured from the first rod.

    The second speed is its rate, or the absolute rate of the second rod.
    """
    rate_b = U_B - U_A if absolute else U_B
    pin, (inner, outer) = hinge(), frames()
    inner.set_ang_vel(WORLD, U_A * WORLD.z)
    outer.set_ang_vel(inner, rate_b * WORLD.z)
    rods = chain(pin, inner, outer)
    weights = [(rod.masscenter, -rod.mass * G * WORLD.y) for rod in rods]
    kane = me.KanesMethod(WORLD, [A, B], [U_A, U_B], kd_eqs=[A.diff() - U_A, B.diff() - rate_b])
    kane.kanes_equations(rods, [*weights, *couples(inner, outer, U_A, rate_b)])
    return kane


def frames():
    inner = WORLD.orientnew("A", "Axis", [A, WORLD.z])
    return inner, inner.orientnew("B", "Axis", [B, WORLD.z])


def chain(pin, inner, outer):
    first, end = rod_on("first", inner, pin, M_1, L_1)
    second, _ = rod_on("second", outer, end, M_2, L_2)
    return [first, second]


def couples(inner, outer, rate_a, rate_b):
    first, second = (T_A - D * rate_a) * WORLD.z, (T_B - D * rate_b) * WORLD.z
    return [(inner, first - second), (outer, second)]


class Rods(al.Multibody):
    """The two rods as bodies and joints."""

    m_1: al.Number = 1.3
    m_2: al.Number = 0.8
    l_1: al.Number = 0.9
    l_2: al.Number = 0.6
    d: al.Number = 0.15
    g: al.Number = 9.81

    @property
    def gravity(self):
        return jnp.stack([jnp.zeros(()), -self.g, jnp.zeros(())])

    def bodies(self):
        def rod(name, mass, length, **place):
            inertia = (0.0, 0.0, mass * length**2 / 12)
            hinged = al.joints.Revolute("z")
            return al.Body(name, joint=hinged, mass=mass, center=(length / 2, 0.0, 0.0), inertia=inertia, **place)

        return (
            rod("a", self.m_1, self.l_1),
            rod("b", self.m_2, self.l_2, parent="a", position=(self.l_1, 0.0, 0.0)),
        )

    def bias(self, q, v):
        return super().bias(q, v) + self.d * v


@compiled
def motions(model, q, v, force):
    """Accelerations at many states, and their derivatives by every number of the model at the first of them."""
    accelerations = jax.vmap(model.forward_dynamics)(q, v, force)
    return accelerations, jax.jacfwd(lambda one: one.forward_dynamics(q[0], v[0], force[0]))(model)


def traced(model):
    return jax.tree.map(lambda number: jnp.asarray(number, dtype=float), model)


def states(count):
    generator = np.random.default_rng(3)
    return [generator.normal(size=(count, 2)) * scale for scale in (2.0, 4.0, 5.0)]


@pytest.mark.slow
def test_accelerations_of_a_double_pendulum_and_their_derivatives_are_those_of_bodies_and_joints():
    at = states(50)
    (found, slopes), (expected, expected_slopes) = (
        motions(traced(model), *at) for model in (al.foreign.from_kane(rods_by_kane(), RODS), Rods())
    )
    assert np.abs(expected).max() > 10
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    for name in ("m_1", "m_2", "l_1", "l_2", "d", "g"):
        wanted = np.asarray(getattr(expected_slopes, name))
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(slopes.numbers[name], wanted, rtol=1e-11, atol=1e-11 * scale, err_msg=name)
        assert scale > 1e-3


@pytest.mark.slow
def test_speeds_that_are_no_rates_of_coordinates_describe_the_same_motion_under_torques():
    outputs = {"spin": B.diff(), "gained": U_B.diff() - U_A.diff()}
    model = al.foreign.from_kane(rods_by_kane(absolute=True), RODS, outputs=outputs)
    assert not model.moves_directly
    grid, start = al.Grid(0.5, 100), {"a": 0.4, "b": -0.9}
    first, second = al.PowerSeries(start=(0.5, -1.0)), al.PowerSeries(start=(-0.3, 2.0))
    system = al.ForwardDynamics(model, torque={"t_a": first, "t_b": second}, start=start | {"u_a": 1.0, "u_b": 3.0})
    torque, rates = {"a_torque": first, "b_torque": second}, {"a_rate": 1.0, "b_rate": 2.0}
    ours = al.simulate(al.ForwardDynamics(Rods(), torque=torque, start=start | rates), grid)
    found = al.simulate(system, grid)
    for theirs, name in (("a", "a"), ("spin", "b_rate"), ("gained", "b_acceleration"), ("a_acceleration",) * 2):
        np.testing.assert_allclose(found[theirs], ours[name], rtol=0, atol=1e-9, err_msg=name)


X, Y = me.dynamicsymbols("x y")


def ball():
    """A point mass, and its Lagrangian."""
    pin = hinge()
    place = pin.locatenew("P", X * WORLD.x + Y * WORLD.y)
    place.set_vel(WORLD, place.pos_from(pin).dt(WORLD))
    mass = me.Particle("ball", place, M)
    mass.potential_energy = M * G * Y
    return me.Lagrangian(WORLD, mass)


def test_holonomic_constraints_hold_exactly_and_multipliers_are_those_of_sympy():
    method = me.LagrangesMethod(ball(), [X, Y], hol_coneqs=[X**2 + Y**2 - L**2])
    method.form_lagranges_equations()
    model = al.foreign.from_lagrange(method, {M: 2.0, L: 0.5, G: 9.81}, outputs={"tension": -2 * L * method.lam_vec[0]})
    system = al.ForwardDynamics(model, start={"x": 0.3}, guess={"y": -0.4})
    found = {name: np.asarray(one) for name, one in al.simulate(system, al.Grid(1.0, 400)).items()}
    assert np.ptp(found["x"]) > 0.5
    np.testing.assert_allclose(found["x"] ** 2 + found["y"] ** 2, 0.25, rtol=1e-12)
    # It starts at rest, 0.1 m above the lowest place: v² = 2 g (y(0) - y), and m v² / l + m g cos(angle) holds it.
    y = found["y"]
    np.testing.assert_allclose(found["tension"], 2 * (2 * 9.81 * (-0.4 - y)) / 0.5 - 2 * 9.81 * y / 0.5, rtol=1e-6)
