"""The arm of sections 5.5.1 and 5.5.2: two links in the horizontal plane, with a payload of uncertain mass at the
tip.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import aleator as al

START = (np.pi / 6, np.pi / 6)
TARGET = (-np.pi / 6, -np.pi / 6)
TORQUE = 10.0
OBSTACLE = al.shapes.Sphere((0.65, 0.80), 0.30)


class TwoLinks(al.Mechanical):
    """Two uniform rods and a point mass at the tip; `q2` is measured from the first link."""

    names = ("q1", "q2")

    payload: al.Number = 0.0
    mass_1: al.Number = al.parameter("kg", positive=True, default=1.0)
    mass_2: al.Number = al.parameter("kg", positive=True, default=1.0)
    length_1: al.Number = al.parameter("m", positive=True, default=1.0)
    length_2: al.Number = al.parameter("m", positive=True, default=1.0)

    def mass_matrix(self, q: Float[Array, " 2"]) -> Float[Array, "2 2"]:
        """`M(q)`, kg m²: rods of inertia `m l²/12` about their middles."""
        l_1, l_2 = self.length_1, self.length_2
        inner = self.mass_1 * l_1**2 / 3 + (self.mass_2 + self.payload) * l_1**2
        outer = (self.mass_2 / 3 + self.payload) * l_2**2
        coupling = (self.mass_2 / 2 + self.payload) * l_1 * l_2 * jnp.cos(q[1])
        return jnp.array([[inner + outer + 2 * coupling, outer + coupling], [outer + coupling, outer]])

    def coriolis(self, q: Float[Array, " 2"], v: Float[Array, " 2"]) -> Float[Array, "2 2"]:
        """`C(q, v)`, kg m²/s."""
        h = (self.mass_2 / 2 + self.payload) * self.length_1 * self.length_2 * jnp.sin(q[1])
        return jnp.array([[-h * v[1], -h * (v[0] + v[1])], [h * v[0], 0.0]])


class TwoLinkArm(TwoLinks):
    """The arm in the horizontal plane, where gravity does no work, with an `obstacle` that the links must avoid."""

    units: ClassVar = {
        **dict.fromkeys(TwoLinks.names, "rad"),
        **{f"{name}_rate": "rad/s" for name in TwoLinks.names},
        **{f"{name}_acceleration": "rad/s²" for name in TwoLinks.names},
        **{f"{name}_torque": "N m" for name in TwoLinks.names},
        **dict.fromkeys(("elbow_x", "elbow_y", "tip_x", "tip_y", "gap_1", "gap_2"), "m"),
    }

    payload: al.Number = al.parameter("kg", positive=True)
    obstacle: al.shapes.Sphere = OBSTACLE

    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        """The positions of elbow and tip, and the links' distances from the obstacle, m."""
        elbow, tip = self.places(motion.q)
        places = {"elbow_x": elbow[0], "elbow_y": elbow[1], "tip_x": tip[0], "tip_y": tip[1]}
        links = al.shapes.Capsule((0.0, 0.0), elbow), al.shapes.Capsule(elbow, tip)
        return places | {f"gap_{i}": al.shapes.distance(link, self.obstacle) for i, link in enumerate(links, 1)}

    def places(self, q: Float[Array, " 2"]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """The elbow and the tip, m."""
        first, second = q[0], q[0] + q[1]
        elbow = self.length_1 * jnp.array([jnp.cos(first), jnp.sin(first)])
        return elbow, elbow + self.length_2 * jnp.array([jnp.cos(second), jnp.sin(second)])


def bent_path(bend: float = 1.9, instants: int = 61) -> Float[np.ndarray, "instants 2"]:
    """A path from start to target, at rest at both, that draws the tip in by bending the elbow `bend` rad more.

    It passes the obstacle on the side of the base, as fast plans and plans of little effort do. Searches from other
    paths end at other plans.
    """
    fractions = np.linspace(0.0, 1.0, instants)
    rise = 10 * fractions**3 - 15 * fractions**4 + 6 * fractions**5
    line = np.array(START) + rise[:, None] * (np.array(TARGET) - np.array(START))
    return line + np.sin(np.pi * fractions)[:, None] ** 2 * bend * np.array([-0.5, 1.0])


def clear_of_wall_and_obstacle(sigmas: float = 0.0) -> list[al.Constraint]:
    """Elbow and tip stay before the wall at x = 0, and both links clear of the obstacle, by `sigmas` standard
    deviations.
    """
    distances = {"elbow_x": "wall", "tip_x": "wall", "gap_1": "obstacle", "gap_2": "obstacle"}
    return [al.path(name).at_least(0.0, sigmas=sigmas).named(limit) for name, limit in distances.items()]
