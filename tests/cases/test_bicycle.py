"""The benchmark bicycle: leaning and steering, stable between 4.29 and 6.02 m/s.

Meijaard, Papadopoulos, Ruina and Schwab, Linearized dynamics equations for the balance and steer of a bicycle (2007):
bodies on wheels that roll without slip, by velocity constraints.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import aleator as al
from compiling import compiled

WEAVE = 4.29238253634111
"""The speed, m/s, above which the bicycle does not weave."""
RADII = {"rear": 0.3, "front": 0.35}


class Rolling(al.Multibody):
    """The bicycle of the paper's table 1, z upwards: frame and rider, fork, and two thin wheels that roll."""

    constraint_names = ("rear_height", "front_height")
    velocity_constraint_names = ("rear_x", "rear_y", "front_x", "front_y")
    actuators = ("steer_torque",)

    def bodies(self):
        tilt = np.pi / 10
        ridden = {"mass": 85.0, "center": (0.3, 0.0, 0.6), "inertia": (9.2, 11.0, 2.8, 0.0, -2.4, 0.0)}
        fork = {"mass": 4.0, "center": (-0.2, 0.0, 0.7), "inertia": (0.05892, 0.06, 0.00708, 0.0, 0.00756, 0.0)}
        axle, axis = al.joints.Revolute("y"), al.joints.Revolute((np.sin(tilt), 0.0, -np.cos(tilt)))
        front = {"position": (-0.08, 0.0, 0.35), "mass": 3.0, "inertia": (0.1405, 0.28, 0.1405)}
        return (
            al.Body("frame", joint=al.joints.Free(), **ridden),
            al.Body("rear", parent="frame", joint=axle, mass=2.0, inertia=(0.0603, 0.12, 0.0603)),
            # Its origin is where the axis of steering meets the ground.
            al.Body("steer", parent="frame", joint=axis, position=(1.1, 0.0, -0.3), **fork),
            al.Body("front", parent="steer", joint=axle, **front),
        )

    def contacts(self, q):
        """Each wheel with the pose of its centre, and the way from there to the ground, in the world's axes."""
        poses = self.poses(q)
        for wheel, radius in RADII.items():
            axle = poses[wheel].rotation[:, 1]
            up = jnp.array([0.0, 0.0, 1.0]) - axle[2] * axle
            yield wheel, poses[wheel], -radius * up / jnp.sqrt(up @ up)

    def constraint(self, q):
        return tuple(pose.position[2] + down[2] for _, pose, down in self.contacts(q))

    def velocity_constraint(self, q, v):
        touching = [self.point_velocity(q, v, wheel, pose.rotation.T @ down) for wheel, pose, down in self.contacts(q)]
        return tuple(velocity[i] for velocity in touching for i in range(2))


class State(NamedTuple):
    q: jax.Array
    v: jax.Array


@cache
def rolling_eigenvalues(speed):
    """Those that do not vanish, of the ride straight ahead."""
    model = Rolling()
    spins = [model.speeds.index(f"{wheel}_rate") for wheel in RADII]

    @compiled
    def slope(speed):
        posture = jnp.zeros(10).at[jnp.array([2, 3])].set(jnp.array([RADII["rear"], 1.0]))
        rolling = jnp.zeros(9).at[0].set(speed).at[jnp.array(spins)].set(speed / jnp.array([*RADII.values()]))
        flat, named = ravel_pytree(State(posture, rolling))

        def rates(state):
            return ravel_pytree(al.ForwardDynamics(model).rhs(0.0, named(state), torque=jnp.zeros(1)))[0]

        return jax.jacobian(rates)(flat)

    every = np.linalg.eigvals(slope(speed))
    return np.sort_complex(every[np.abs(every) > 1e-4])


@pytest.mark.slow
def test_bodies_on_wheels_that_roll_have_the_published_eigenvalues_and_weave_speed():
    weave = -0.77534188 + 4.46486771j
    published = [-14.07838969, weave.conjugate(), weave, -0.32286643]
    assert rolling_eigenvalues(5.0) == pytest.approx(np.array(published), abs=1e-8)
    assert rolling_eigenvalues(WEAVE)[-1].real == pytest.approx(0.0, abs=1e-10)
