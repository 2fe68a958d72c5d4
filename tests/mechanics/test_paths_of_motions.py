"""What is looked at along a motion: actuation that is lost, gimbal lock, and what is no fault of the model."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import aleator as al

ACROSS = al.PowerSeries(start=(1.0, 0.0), end=(-1.0, 0.0))


class Levered(al.Mechanical):
    """Two masses, whose motors pull alike where x is zero."""

    names = ("x", "y")

    def mass_matrix(self, q):
        return np.eye(2)

    def actuation(self, q):
        return [[1.0, 1.0], [1.0, 1.0 + q[0]]]


class Pulled(Levered):
    """Two masses: the motor of the first loses its grip where x is zero."""

    actuator_names = ("winch",)

    def actuation(self, q):
        return [[q[0]], [0.0]]


def test_torques_that_lose_their_effect_are_found_at_and_between_instants():
    steps, when = 11, "between t = 0.4545 s and t = 0.5455 s (x = 0.13"
    grid = al.Grid(1.0, steps)
    inverse = al.InverseDynamics(Levered(), motion={"x": ACROSS, "y": 0.0})
    assert f"Levered lose their effect {when}" in inverse.diagnose(grid)
    hybrid = al.HybridDynamics(Pulled(), motion={"x": ACROSS})
    assert "Pulled lose their effect at t = 0.5 s (x = 0" in hybrid.diagnose(al.Grid(1.0, 10))


class Mapped(al.Mechanical):
    """Velocities whose map is what one says."""

    map: Any = ((1.0, 0.0), (0.0, 1.0))
    names = ("x", "angle")
    velocity_names = ("a", "b")

    def mass_matrix(self, q):
        return np.eye(2)

    def velocity_map(self, q):
        return self.map


def test_a_velocity_map_in_very_different_units_is_no_gimbal_lock():
    assert al.ForwardDynamics(Mapped(map=((1e9, 0.0), (0.0, 1.0)))).diagnose(al.Grid(1.0, 4)) == ""
    for locked in (((1e9, 1.0), (1e9, 1.0)), ((1.0, 0.0), (0.0, 0.0))):
        assert "gimbal lock" in al.ForwardDynamics(Mapped(map=locked)).diagnose(al.Grid(1.0, 4))


class Stiff(al.Multibody):
    """A block on a very stiff, well damped slide of an arm that swings."""

    gravity = (0.0, -9.81, 0.0)

    def bodies(self):
        slide = al.joints.Prismatic("x", stiffness=1e6, damping=3.4e3)
        return (
            al.Body("arm", joint=al.joints.Revolute("z"), mass=1.0, center=(0.5, 0.0, 0.0), inertia=(0, 0, 0.1)),
            al.Body("block", parent="arm", joint=slide, mass=1.0, inertia=(0, 0, 0.1)),
        )


def test_a_stiff_model_is_not_blamed_for_steps_that_are_too_long_for_it():
    system = al.ForwardDynamics(Stiff(), start={"arm_rate": 1.0, "block": 0.3})
    assert system.diagnose(al.Grid(2.0, 100)) == ""


class Coupled(al.Mechanical):
    """A mass matrix that is singular where x is one."""

    names = ("x", "y")

    def mass_matrix(self, q):
        return jnp.array([[1.0, q[0]], [q[0], 1.0]])


def test_a_singular_mass_matrix_is_named():
    motionless = {"x": 1.0 - 1e-13, "x_rate": 0.0}
    diagnosis = al.ForwardDynamics(Coupled(), start=motionless).diagnose(al.Grid(1.0, 4))
    assert "mass matrix of Coupled is singular at the start" in diagnosis
