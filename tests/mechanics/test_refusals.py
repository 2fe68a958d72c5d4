"""What mechanical systems refuse, in words: classes, motions, dynamics, loads and times."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import ClosedTree, SliderCrank
from double_pendulum import Matrices, Pendubot, Rates, simulate

import aleator as al
from zoo import Cart, Decay

GRID = al.Grid(1.0, 10)
REST = (np.zeros(2), np.zeros(2), np.zeros(2))
MOTION = al.BSpline(
    al.Decision(np.ones((2, 2)), -3.0, 3.0), start=REST, end=(np.ones(2), np.zeros(2), np.zeros(2)), degree=5
)


def problem(system):
    return al.Problem(system, grid=GRID, minimize=al.objectives.final_time())


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
        (lambda: problem(flat((1.0, 0.2), (0.0, 1.0))), "is not symmetric at the start"),
        # `C v` in the place of `C`: the product with `v` would be one number, added to all forces.
        (lambda: problem(changed(coriolis=lambda self, q, v: v)), r"coriolis\(q, v\): expected shape \(2, 2\)"),
        (lambda: problem(al.ForwardDynamics(Energy())), "expected a quadratic function of the velocities"),
        (
            lambda: problem(changed(Rates, accelerations=lambda self, q, v, torque: torque**2)),
            "expected accelerations affine in the torques",
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


# --- What is looked at along a motion ---------------------------------------------------------------------------------


ACROSS = al.PowerSeries(start=(1.0, 0.0), end=(-1.0, 0.0))


class Levered(al.Mechanical):
    """Two masses, whose motors pull alike where x is zero."""

    names = ("x", "y")

    def mass_matrix(self, q):
        return np.eye(2)

    def actuation(self, q):
        return [[1.0, 1.0], [1.0, 1.0 + q[0]]]


def test_torques_that_lose_their_effect_are_found_between_instants():
    steps, when = 11, "between t = 0.4545 s and t = 0.5455 s (x = 0.13"
    grid = al.Grid(1.0, steps)
    inverse = al.InverseDynamics(Levered(), motion={"x": ACROSS, "y": 0.0})
    assert f"Levered lose their effect {when}" in inverse.diagnose(grid)


# --- Misnamed parts of a class, and motions that a mechanism cannot make ----------------------------------------------


def test_constraints_and_closures_of_a_base_class_that_would_be_lost_are_refused_by_name():
    with pytest.raises(
        al.ProblemError, match=r"Odd\.constraint_names leaves out \['length', 'height'\] of SliderCrank"
    ):
        type("Odd", (SliderCrank,), {"constraint_names": ("gear",), "constraint": lambda self, q: (q[0],)})
    odd = type("Odd", (ClosedTree,), {"closures": lambda self: ()})()
    with pytest.raises(al.ProblemError, match=r"Odd\.closures leaves out \['pin'\] of ClosedTree"):
        al.ForwardDynamics(odd)


def one_force(self, q, v):
    return v


@pytest.mark.parametrize(
    ("base", "name", "value", "right"),
    [
        (al.Mechanical, "constraints_names", ("a",), "constraint_names"),
        (al.Mechanical, "force", one_force, "forces"),
        (al.Mechanical, "dissipation", one_force, r"Mechanical has no dissipation\(q, v\)"),
        (al.Lagrangian, "forces", one_force, r"Lagrangian has no forces\(q, v\).*load"),
        (al.Multibody, "forces", one_force, r"Multibody has no forces\(q, v\).*load"),
        (al.Accelerations, "coriolis", one_force, r"Accelerations has no coriolis\(q, v\)"),
        (Slide, "forces", one_force, r"Multibody has no forces"),
        (Decay, "intial", one_force, "initial"),
        (Decay, "event", {}, "events"),
    ],
)
def test_what_a_class_would_not_read_is_refused_where_the_class_is_made(base, name, value, right):
    with pytest.raises(al.ProblemError, match=rf"Odd\.{name} .*{right}"):
        type("Odd", (base,), {name: value})


class Knife(al.Mechanical):
    """A knife edge on a plane, which does not move sideways."""

    names = ("x", "y", "phi")
    velocity_names = ("s", "w")
    actuator_names = ("push", "steer")

    def mass_matrix(self, q):
        return jnp.eye(2)

    def velocity_map(self, q):
        return jnp.array([[jnp.cos(q[2]), 0.0], [jnp.sin(q[2]), 0.0], [0.0, 1.0]])

    def actuation(self, q):
        return jnp.eye(2)


STILL, MOVE = (al.PowerSeries(start=(0.0, 0.0), end=(end, 0.0)) for end in (0.0, 1.0))


def test_a_motion_that_a_mechanism_cannot_make_is_refused_with_the_rate_that_it_misses():
    sideways = al.InverseDynamics(Knife(), motion={"x": STILL, "y": MOVE, "phi": STILL})
    # A cubic from rest to rest in a second is fastest in the middle.
    assert "at t = 0.5 s a rate misses velocity_map(q) times the velocities by 1.5" in sideways.diagnose(
        al.Grid(1.0, 4)
    )
    forward = simulate(al.InverseDynamics(Knife(), motion={"x": MOVE, "y": STILL, "phi": STILL}), al.Grid(1.0, 4))
    np.testing.assert_allclose(forward["push"], 6.0 - 12.0 * np.linspace(0.0, 1.0, 5), rtol=0, atol=1e-12)
    assert forward["motion_error"].max() < 1e-12
