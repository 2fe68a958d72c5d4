"""Pendulums of uniform rods by SymPy, by Kane's and by Lagrange's method, and the same bodies of our own."""

from functools import cache

import jax.numpy as jnp
import sympy as sp
from sympy.physics import mechanics as me

import aleator as al

M, L, D, G = sp.symbols("m l d g")
THETA, OMEGA, TAU = me.dynamicsymbols("theta omega tau")
ROD = {M: 1.0, L: 1.0, D: 0.1, G: 9.81}

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


def weights(rods):
    return [(rod.masscenter, -rod.mass * G * WORLD.y) for rod in rods]


def heights(rods, pin):
    return [rod.mass * G * rod.masscenter.pos_from(pin).dot(WORLD.y) for rod in rods]


@cache
def rod_by_kane():
    """One rod on a hinge with damping and a torque; the angle is measured from horizontal."""
    pin, frame = hinge(), WORLD.orientnew("A", "Axis", [THETA, WORLD.z])
    frame.set_ang_vel(WORLD, OMEGA * WORLD.z)
    rod, _ = rod_on("rod", frame, pin, M, L)
    kane = me.KanesMethod(WORLD, [THETA], [OMEGA], kd_eqs=[THETA.diff() - OMEGA])
    kane.kanes_equations([rod], [*weights([rod]), (frame, (TAU - D * OMEGA) * WORLD.z)])
    return kane


@cache
def rod_by_lagrange():
    pin, frame = hinge(), WORLD.orientnew("A", "Axis", [THETA, WORLD.z])
    rod, _ = rod_on("rod", frame, pin, M, L)
    rod.potential_energy = heights([rod], pin)[0]
    load = (frame, (TAU - D * THETA.diff()) * WORLD.z)
    method = me.LagrangesMethod(me.Lagrangian(WORLD, rod), [THETA], forcelist=[load], frame=WORLD)
    method.form_lagranges_equations()
    return method


@cache
def rods_by_kane():
    """Two rods in a row, with damping and a torque in each joint; the second angle is measured from the first rod."""
    pin, (inner, outer) = hinge(), frames()
    inner.set_ang_vel(WORLD, U_A * WORLD.z)
    outer.set_ang_vel(inner, U_B * WORLD.z)
    rods = chain(pin, inner, outer)
    kinematics = [A.diff() - U_A, B.diff() - U_B]
    kane = me.KanesMethod(WORLD, [A, B], [U_A, U_B], kd_eqs=kinematics)
    kane.kanes_equations(rods, [*weights(rods), *couples(inner, outer, U_A, U_B)])
    return kane


@cache
def rods_by_lagrange():
    pin, (inner, outer) = hinge(), frames()
    rods = chain(pin, inner, outer)
    for rod, height in zip(rods, heights(rods, pin), strict=True):
        rod.potential_energy = height
    loads = couples(inner, outer, A.diff(), B.diff())
    method = me.LagrangesMethod(me.Lagrangian(WORLD, *rods), [A, B], forcelist=loads, frame=WORLD)
    method.form_lagranges_equations()
    return method


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
