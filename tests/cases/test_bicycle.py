"""The benchmark bicycle at an uncertain speed: leaning and steering, stable between 4.29 and 6.02 m/s.

Meijaard, Papadopoulos, Ruina and Schwab, Linearized dynamics equations for the balance and steer of a bicycle (2007):
by their linear equations, and as bodies on wheels that roll without slip, by velocity constraints.
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

G = 9.81
MASS = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
DAMPING = np.array([[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
WEIGHT = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
ROLLING = np.array([[0.0, 76.59734589573222], [0.0, 2.65431523794604]])


class Bicycle(al.Mechanical):
    names = ("lean", "steer")

    speed: al.Number

    def mass_matrix(self, q):
        return jnp.asarray(MASS)

    def forces(self, q, v):
        return self.speed * DAMPING @ v + (G * WEIGHT + self.speed**2 * ROLLING) @ q


def ridden(speed, seconds):
    start = {"lean_rate": 0.5}
    return al.simulate(al.ForwardDynamics(Bicycle(speed=speed), start=start), al.Grid(seconds, round(100 * seconds)))


def eigenvalues(speed):
    def rates(state):
        return jnp.concatenate([state[2:], Bicycle(speed).forward_dynamics(state[:2], state[2:], jnp.zeros(2))])

    return np.sort_complex(np.linalg.eigvals(jax.jacobian(rates)(jnp.zeros(4))))


@pytest.mark.slow
def test_eigenvalues_are_the_published_ones():
    weave = -0.77534188 + 4.46486771j
    assert eigenvalues(5.0) == pytest.approx(np.array([-14.07838969, weave.conjugate(), weave, -0.32286643]), abs=1e-8)
    assert eigenvalues(4.0)[-1] == pytest.approx(0.41325332 + 3.07910819j, abs=1e-8)
    assert eigenvalues(4.29238253634111)[-1].real == pytest.approx(0.0, abs=1e-12)
    assert eigenvalues(6.02426201538837)[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_a_ride_at_one_speed():
    found = ridden(4.6, 1.0)
    end = [found[name][-1] for name in ("lean", "steer", "lean_rate", "steer_rate")]
    assert end == pytest.approx([-0.05295143, -0.04375018, -0.24956774, -0.37639701], abs=1e-7)


@pytest.mark.slow
def test_a_family_that_stays_up():
    # At order 6 the spread after 5 s is off by 1.4e-5, at order 8 by 4e-8.
    found = al.expand(
        lambda at: ridden(at["speed"], 5.0)["lean"], {"speed": al.Uniform.bounds(4.2, 5.0)}, al.Expansion(order=8)
    )
    instants = [100, 200, 500]
    assert np.asarray(found.mean)[instants] == pytest.approx([-0.0524441149, 0.0629201813, -0.0337498469], abs=1e-6)
    assert np.asarray(found.std)[instants] == pytest.approx([0.0133748150, 0.0220771150, 0.0677586233], abs=1e-6)


@pytest.mark.slow
def test_a_family_of_which_some_fall_over_needs_a_higher_order():
    speeds = {"speed": al.Uniform.bounds(3.5, 6.5)}

    def lean(at):
        return ridden(at["speed"], 5.0)["lean"][-1]

    with pytest.warns(al.ExpansionWarning, match="does not resolve the output"):
        al.expand(lean, speeds, al.Expansion(order=3))
    for order, error in ((8, 1e-2), (12, 2e-4)):
        found = al.expand(lean, speeds, al.Expansion(order=order))
        assert [float(found.mean), float(found.std)] == pytest.approx([1.42070580, 4.81444992], rel=error)


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
