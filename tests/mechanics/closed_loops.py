"""A slider-crank: by energies, as a tree of bodies that is closed, and by hand as a function of the crank."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aleator as al

G = 9.81


class SliderCrank(al.Lagrangian):
    """Angles from the horizontal, in the vertical plane; the slider moves along x."""

    names = ("crank", "rod", "slider")
    actuator_names = ("crank_torque",)
    constraint_names = ("length", "height")

    a: al.Number = 0.1
    b: al.Number = 0.3
    crank_inertia: al.Number = 0.01
    rod_mass: al.Number = 0.5
    slider_mass: al.Number = 0.7

    def centre(self, q):
        """That of the rod, halfway."""
        crank, rod = ((jnp.cos(angle), jnp.sin(angle)) for angle in q[:2])
        return self.a * jnp.stack(crank) + 0.5 * self.b * jnp.stack(rod)

    def kinetic_energy(self, q, v):
        c = jax.jvp(self.centre, (q,), (v,))[1]
        rod = self.rod_mass * (c @ c + self.b**2 / 12 * v[1] ** 2)
        return 0.5 * (self.crank_inertia * v[0] ** 2 + rod + self.slider_mass * v[2] ** 2)

    def potential_energy(self, q):
        return G * self.rod_mass * self.centre(q)[1]

    def constraint(self, q) -> Any:
        return (
            self.a * jnp.cos(q[0]) + self.b * jnp.cos(q[1]) - q[2],
            self.a * jnp.sin(q[0]) + self.b * jnp.sin(q[1]),
        )


class ClosedTree(al.Multibody):
    """The same crank and rod, the rod measured from the crank, and a slider that a closure binds to the rod's end."""

    a: al.Number = 0.1
    planar: bool = eqx.field(static=True, default=True)
    gravity = (0.0, -G, 0.0)
    actuators = ("crank_torque",)

    def bodies(self):
        pin = al.joints.Revolute("z")
        rod = {"mass": 0.5, "center": (0.15, 0.0, 0.0), "inertia": (0.0, 0.0, 0.5 * 0.3**2 / 12)}
        return (
            al.Body("crank", joint=pin, mass=0.0, inertia=(0.0, 0.0, 0.01)),
            al.Body("rod", parent="crank", joint=pin, position=(self.a, 0.0, 0.0), **rod),
            al.Body("slider", joint=al.joints.Prismatic("x"), mass=0.7),
        )

    def closures(self):
        joint = al.joints.Revolute("z") if self.planar else al.joints.Ball()
        end = (0.3, 0.0, 0.0)
        return (al.joints.Closure("pin", parent="rod", child="slider", joint=joint, position=end, planar=self.planar),)


def slider_crank_by_hand(theta, omega, alpha):
    """Positions, the driving torque and the forces that bear the slider, by elimination; arrays over instants.

    The torque by Newton and Euler on the rod, then on the crank; `wrist` is the force of the slider's pin on the rod.
    """
    a, b, crank_inertia, rod_mass, slider_mass = 0.1, 0.3, 0.01, 0.5, 0.7
    rod = -np.arcsin(a / b * np.sin(theta))
    rod_rate = -a * np.cos(theta) * omega / (b * np.cos(rod))
    rod_acceleration = (a * np.sin(theta) * omega**2 - a * np.cos(theta) * alpha + b * np.sin(rod) * rod_rate**2) / (
        b * np.cos(rod)
    )

    def point(s):
        """The acceleration at a part of the rod's length."""
        x = -a * (np.cos(theta) * omega**2 + np.sin(theta) * alpha)
        y = -a * (np.sin(theta) * omega**2 - np.cos(theta) * alpha)
        x = x - s * b * (np.cos(rod) * rod_rate**2 + np.sin(rod) * rod_acceleration)
        return np.stack([x, y - s * b * (np.sin(rod) * rod_rate**2 - np.cos(rod) * rod_acceleration)])

    centre, end = point(0.5), point(1.0)
    weight = np.array([0.0, -rod_mass * G])[:, None]
    along = b * np.stack([np.cos(rod), np.sin(rod)])
    wrist = np.stack([-slider_mass * end[0], np.zeros_like(theta)])
    # About the crank's pin: moments of the wrist, of the weight, and of inertia.
    needed = rod_mass * b**2 / 12 * rod_acceleration + cross(along / 2, rod_mass * centre - weight)
    wrist[1] = (needed + along[1] * wrist[0]) / along[0]
    pin = rod_mass * centre - weight - wrist  # of the crank on the rod
    torque = crank_inertia * alpha + cross(a * np.stack([np.cos(theta), np.sin(theta)]), pin)
    return {
        "rod": rod,
        "slider": a * np.cos(theta) + b * np.cos(rod),
        "rod_rate": rod_rate,
        "rod_acceleration": rod_acceleration,
        "slider_acceleration": end[0],
        "torque": torque,
        "wrist": wrist,
    }


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]
