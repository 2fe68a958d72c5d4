"""Two point masses on massless rods, with gravity and friction: by energies, matrices, accelerations and by SymPy."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import sympy as sp

import aleator as al
from compiling import compiled

G = 9.81


@compiled
def run(system, grid):
    """A simulation by Runge-Kutta; numbers of system and grid compile nothing anew."""
    return al.simulate(system, grid)


def simulate(system, grid):
    return {name: np.asarray(values) for name, values in run(system, grid).items()}


class Energies(al.Lagrangian):
    """Angles from the horizontal; the second from the first rod."""

    names = ("shoulder", "elbow")

    m_1: al.Number = 1.3
    m_2: al.Number = 0.8
    l_1: al.Number = 0.9
    l_2: al.Number = 0.6
    friction: al.Number = 0.15

    def places(self, q):
        first, second = q[0], q[0] + q[1]
        elbow = self.l_1 * jnp.array([jnp.cos(first), jnp.sin(first)])
        return elbow, elbow + self.l_2 * jnp.array([jnp.cos(second), jnp.sin(second)])

    def kinetic_energy(self, q, v):
        elbow, tip = jax.jvp(self.places, (q,), (v,))[1]
        return 0.5 * (self.m_1 * elbow @ elbow + self.m_2 * tip @ tip)

    def potential_energy(self, q):
        elbow, tip = self.places(q)
        return G * (self.m_1 * elbow[1] + self.m_2 * tip[1])

    def dissipation(self, q, v):
        return 0.5 * self.friction * (v @ v)


class Matrices(al.Mechanical):
    """The same by the matrices of a textbook."""

    names = ("shoulder", "elbow")

    m_1: al.Number = 1.3
    m_2: al.Number = 0.8
    l_1: al.Number = 0.9
    l_2: al.Number = 0.6
    friction: al.Number = 0.15

    def mass_matrix(self, q):
        outer, coupling = self.m_2 * self.l_2**2, self.m_2 * self.l_1 * self.l_2 * jnp.cos(q[1])
        inner = (self.m_1 + self.m_2) * self.l_1**2
        return jnp.array([[inner + outer + 2 * coupling, outer + coupling], [outer + coupling, outer]])

    def coriolis(self, q, v):
        h = self.m_2 * self.l_1 * self.l_2 * jnp.sin(q[1])
        return h * jnp.array([[-v[1], -v[0] - v[1]], [v[0], 0.0]])

    def forces(self, q, v):
        second = G * self.m_2 * self.l_2 * jnp.cos(q[0] + q[1])
        first = G * (self.m_1 + self.m_2) * self.l_1 * jnp.cos(q[0])
        return jnp.array([first + second, second]) + self.friction * v


class Pendubot(Matrices):
    """Actuated at the shoulder only."""

    actuator_names = ("shoulder_torque",)


class Tendons(Matrices):
    """More actuators than coordinates."""

    actuator_names = ("a", "b", "c")

    def actuation(self, q):
        return jnp.array([[1.0, -0.4, 0.3], [0.2, 1.0, -0.7]])


class Rates(al.Accelerations):
    """The same by its accelerations."""

    names = ("shoulder", "elbow")

    model: Matrices = Matrices()

    def accelerations(self, q, v, torque):
        bias = self.model.coriolis(q, v) @ v + self.model.forces(q, v)
        return jnp.linalg.solve(self.model.mass_matrix(q), torque - bias)


PARAMETERS = {"m_1": 1.3, "m_2": 0.8, "l_1": 0.9, "l_2": 0.6, "friction": 0.15}


@cache
def _lagrange():
    t, m_1, m_2, l_1, l_2, friction = sp.symbols("t m_1 m_2 l_1 l_2 friction")
    a, b = sp.Function("a")(t), sp.Function("b")(t)
    elbow = sp.Matrix([l_1 * sp.cos(a), l_1 * sp.sin(a)])
    tip = elbow + sp.Matrix([l_2 * sp.cos(a + b), l_2 * sp.sin(a + b)])
    kinetic = (m_1 * elbow.diff(t).dot(elbow.diff(t)) + m_2 * tip.diff(t).dot(tip.diff(t))) / 2
    action = kinetic - G * (m_1 * elbow[1] + m_2 * tip[1])
    equations = sp.Matrix([action.diff(one.diff(t)).diff(t) - action.diff(one) for one in (a, b)])
    accelerations = [a.diff(t, 2), b.diff(t, 2)]
    mass = equations.jacobian(accelerations)
    bias = equations.subs(dict.fromkeys(accelerations, 0)) + friction * sp.Matrix([a.diff(t), b.diff(t)])
    plain = sp.symbols("a b a_rate b_rate")
    names = dict(zip((a.diff(t), b.diff(t), a, b), (plain[2], plain[3], plain[0], plain[1]), strict=True))
    return sp.lambdify((*plain, m_1, m_2, l_1, l_2, friction), [part.subs(names) for part in (mass, bias)])


def by_sympy(q, v, **changes):
    """Mass matrix and bias from the Lagrangian, by SymPy."""
    mass, bias = _lagrange()(*q, *v, *(PARAMETERS | changes).values())
    return np.asarray(mass, float), np.asarray(bias, float).ravel()


def forces_along(history, **changes):
    """`M v̇ + C v + N` at each instant of a simulation, from its own coordinates, rates and accelerations."""
    q, v, a = (np.stack([history[f"{name}{end}"] for name in ("shoulder", "elbow")], 1) for end in _ENDS)
    both = [by_sympy(*at, **changes) for at in zip(q, v, strict=True)]
    return np.stack([mass @ one + bias for (mass, bias), one in zip(both, a, strict=True)])


_ENDS = ("", "_rate", "_acceleration")
