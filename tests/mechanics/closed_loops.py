"""A slider-crank and a four-bar linkage: as closed loops, and by hand, with everything as a function of the crank."""

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


class FourBar(al.Multibody):
    """Crank, coupler and rocker as homogeneous bars in the vertical plane, the ground between both supports."""

    crank: al.Number = 0.1
    coupler: al.Number = 0.35
    rocker: al.Number = 0.3
    ground: al.Number = 0.4
    driven: tuple[str, ...] = eqx.field(static=True, default=("crank_torque",))
    planar: bool = eqx.field(static=True, default=True)
    gravity = (0.0, -G, 0.0)
    masses = (0.3, 0.5, 0.4)

    def bodies(self):
        def bar(name, length, mass, **given):
            inertia = (0.0, 0.0, mass * length**2 / 12)
            center = (length / 2, 0.0, 0.0)
            return al.Body(name, joint=al.joints.Revolute("z"), mass=mass, center=center, inertia=inertia, **given)

        crank, coupler, rocker = self.masses
        return (
            bar("crank", self.crank, crank),
            bar("coupler", self.coupler, coupler, parent="crank", position=(self.crank, 0.0, 0.0)),
            bar("rocker", self.rocker, rocker, position=(self.ground, 0.0, 0.0)),
        )

    def closures(self) -> Any:
        joint = al.joints.Revolute("z") if self.planar else al.joints.Ball()
        return (
            al.joints.Closure(
                "pin",
                parent="coupler",
                child="rocker",
                joint=joint,
                position=(self.coupler, 0.0, 0.0),
                child_position=(self.rocker, 0.0, 0.0),
                planar=self.planar,
            ),
        )

    @property
    def actuators(self):
        return self.driven


NEAR = {"coupler": -0.5, "rocker": 1.8}
"""Near the open branch of the four-bar."""


def slider_crank_by_hand(
    theta, omega, alpha, a: Any = 0.1, b: Any = 0.3, crank_inertia=0.01, rod_mass=0.5, slider_mass=0.7
):
    """Positions, the driving torque and the forces that bear the slider, by elimination; arrays over instants.

    The torque by Newton and Euler on the rod, then on the crank; `wrist` is the force of the slider's pin on the rod.
    """
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


def four_bar_by_hand(theta, omega, alpha, lengths=(0.1, 0.35, 0.3, 0.4), masses=(0.3, 0.5, 0.4)):
    """Angles from the horizontal, the driving torque, and the force of the coupler on the rocker, in the world's axes.

    By the triangle of coupler, rocker and diagonal, and by Newton and Euler on coupler and rocker together.
    """
    (a, b, c, d), (crank, coupler, rocker) = lengths, masses
    pin = a * unit(theta)
    diagonal = np.stack([np.full_like(theta, d), np.zeros_like(theta)]) - pin
    f = np.hypot(*diagonal)
    third = np.arctan2(diagonal[1], diagonal[0]) + np.arccos((b**2 + f**2 - c**2) / (2 * b * f))
    end = pin + b * unit(third) - np.array([d, 0.0])[:, None]
    fourth = np.arctan2(end[1], end[0])
    # b third' n3 - c fourth' n4 = - a omega n2, and once more differentiated.
    left = np.stack([b * normal(third), -c * normal(fourth)], axis=1).transpose(2, 0, 1)
    rates = np.linalg.solve(left, -(a * omega * normal(theta)).T[..., None])[..., 0].T
    right = -a * (alpha * normal(theta) - omega**2 * unit(theta))
    right = right + b * rates[0] ** 2 * unit(third) - c * rates[1] ** 2 * unit(fourth)
    accelerations = np.linalg.solve(left, right.T[..., None])[..., 0].T
    weight = np.array([0.0, -G])[:, None]
    at_pin = a * (alpha * normal(theta) - omega**2 * unit(theta))
    centre = at_pin + b / 2 * (accelerations[0] * normal(third) - rates[0] ** 2 * unit(third))
    # Moments of the coupler about the crank's pin and of the rocker about its support: two equations for the force F
    # on the rocker.
    arm, other = b * unit(third), c * unit(fourth)
    needed = coupler * b**2 / 12 * accelerations[0] + cross(arm / 2, coupler * (centre - weight))
    borne = rocker * c**2 / 3 * accelerations[1] - cross(other / 2, rocker * (weight + 0 * other))
    matrix = np.stack([np.stack([arm[1], -arm[0]]), np.stack([-other[1], other[0]])]).transpose(2, 0, 1)
    force = np.linalg.solve(matrix, np.stack([needed, borne], axis=1)[..., None])[..., 0].T
    on_coupler = coupler * (centre - weight) + force  # of the crank's pin
    torque = crank * a**2 / 3 * alpha + cross(a * unit(theta), on_coupler - crank * weight / 2)
    return {"coupler": third, "rocker": fourth, "rocker_rate": rates[1], "torque": torque, "force": force}


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)])


def normal(angle):
    return np.stack([-np.sin(angle), np.cos(angle)])


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]
