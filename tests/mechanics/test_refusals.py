"""What dynamics, loads and times of mechanical systems refuse, in words, before anything is compiled."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import Matrices, Pendubot, Rates

import aleator as al
from zoo import Cart

GRID = al.Grid(1.0, 10)
REST = (np.zeros(2), np.zeros(2), np.zeros(2))
MOTION = al.BSpline(
    al.Decision(np.ones((2, 2)), -3.0, 3.0), start=REST, end=(np.ones(2), np.zeros(2), np.zeros(2)), degree=5
)


def problem(system, *constraints):
    return al.Problem(system, grid=GRID, minimize=al.objectives.final_time(), subject_to=constraints)


class Flat(Matrices):
    """A mass matrix that is what one says."""

    matrix: Any = ((1.0, 0.0), (0.0, 1.0))

    def mass_matrix(self, q):
        return jnp.array(self.matrix)


class Energy(al.Lagrangian):
    names = ("x",)

    def kinetic_energy(self, q, v):
        return (v @ v) ** 2


class Slide(al.Multibody):
    high: al.Number = 0.0

    def bodies(self):
        return (al.Body("a", joint=al.joints.Prismatic("x"), mass=1.0, position=(0.0, 0.0, self.high)),)


WIND = al.processes.RandomProcess(al.processes.SquaredExponentialCovariance(1.0), t_final=2.0, std=0.4, modes=3)
RISING = al.processes.signal(lambda t, p: 0.1 * t)
FADING = al.processes.signal(lambda t, p: 0.5 - t)
TABLE = al.Tabulated([0.0, 1.0], [0.0, 1.0])


def changed(base=Matrices, **parts):
    """Forward dynamics of a class that differs from the base in some attributes."""
    return al.ForwardDynamics(type("Odd", (base,), parts)())


def flat(*rows):
    return al.ForwardDynamics(Flat(matrix=rows))


def inverse(motion, model=Matrices):
    return al.InverseDynamics(model(), motion=motion)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: inverse(MOTION, Pendubot), r"Pendubot is under-actuated: .*Use al\.HybridDynamics"),
        (lambda: inverse({"shoulder": TABLE, "elbow": 0.0}), "a prescribed motion needs velocity and acceleration"),
        (lambda: problem(flat((1.0, 1.0), (1.0, 1.0))), "singular at the start .*resists"),
        (lambda: problem(flat((1.0, 0.0), (0.0, -1.0))), "not positive definite at the start"),
        (lambda: problem(flat((1.0, 0.2), (0.0, 1.0))), "is not symmetric at the start"),
        # `C v` in the place of `C`: the product with `v` would be one number, added to all forces.
        (lambda: problem(changed(coriolis=lambda self, q, v: v)), r"coriolis\(q, v\): expected shape \(2, 2\)"),
        (lambda: problem(al.ForwardDynamics(Energy())), "expected a quadratic function of the velocities"),
        (
            lambda: problem(changed(Rates, accelerations=lambda self, q, v, torque: torque**2)),
            "expected accelerations affine in the torques",
        ),
        (
            lambda: problem(changed(Rates, accelerations=lambda self, q, v, torque: torque * (1 + v))),
            "independent of the velocities",
        ),
        (
            lambda: type("Crane", (al.Lagrangian,), {"__annotations__": {"load": al.Number}}),
            "Crane.load: .* has a method of that name, which the field would hide",
        ),
        (lambda: problem(changed(actuator_names=("motor",))), r"\['motor'\] do not say along which velocity"),
        (
            lambda: problem(al.ForwardDynamics(Matrices(m_2=al.Uniform(1.0, half_width=1.2)))),
            r"not positive definite at the start .*In the system with m_2 = -0\.2",
        ),
        (lambda: problem(al.ForwardDynamics(Slide(high=RISING))), "the place or the axis of 'a' depends on time"),
        (
            lambda: problem(changed(Cart, mass_matrix=lambda self, q, t: (1.0 - t) * np.eye(1))),
            r"singular at t = 1 s \(x = 0\)",
        ),
        (lambda: problem(al.ForwardDynamics(Cart(mass=WIND))), "'mass' must stay positive, but a RandomProcess is"),
        (lambda: problem(al.ForwardDynamics(Cart(mass=FADING))), r"is singular at t = 0\.5 s"),
        (
            lambda: al.simulate(al.ForwardDynamics(Matrices()), GRID, inputs={"shoulder_torque": TABLE}),
            r"ForwardDynamics takes no inputs: .* as its `torque`; received the inputs \['shoulder_torque'\]",
        ),
    ],
)
def test_what_cannot_move_is_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_masses_of_very_different_sizes_are_no_singular_matrix():
    # A wheel of a watch on a truck: each resists its own torque well.
    system = al.ForwardDynamics(Flat(matrix=((1e5, 0.0), (0.0, 1e-10))))
    assert system.diagnose(GRID) == ""


def test_limits_of_torques_that_cannot_hold_the_start_are_refused():
    arm = Matrices()
    elbow = 0.99 * 9.81 * arm.m_2 * arm.l_2  # less than its weight takes when it is level
    with pytest.raises(al.ProblemError, match=r"'elbow_torque' .* at t = 0 s whatever the decisions are"):
        al.solve(problem(al.InverseDynamics(arm, motion=MOTION), al.path("elbow_torque").within(-elbow, elbow)))


# --- What is looked at along a motion ---------------------------------------------------------------------------------


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
