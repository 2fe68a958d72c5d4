"""Couplings of a robot are kept; misnamed parts of a class and impossible motions are refused; starts are kept."""

import jax.numpy as jnp
import numpy as np
import pytest
from closed_loops import ClosedTree, SliderCrank
from double_pendulum import simulate
from scipy.integrate import solve_ivp

import aleator as al

GRID = al.Grid(0.3, 60)


COUPLED = """<mujoco><worldbody>
<body name="a"><joint name="ja" type="hinge" axis="0 1 0"/>
<inertial pos="1 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
<body name="b" pos="0 1 0"><joint name="jb" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/></body>
</worldbody><equality><joint name="gear" joint1="jb" joint2="ja" polycoef="0 2 0 0 0"/></equality></mujoco>"""


class Around(al.Multibody):
    robot: al.foreign.Robot

    def bodies(self):
        return self.robot.bodies()

    def closures(self):
        return self.robot.closures()


@pytest.mark.slow
def test_a_model_around_a_robot_keeps_its_couplings(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(COUPLED)
    model = Around(al.foreign.read_mjcf(path))
    assert model.constraints == ("gear",)
    found = simulate(al.ForwardDynamics(model), GRID)
    inertia = 1.0 + 0.1 + 2.0**2 * 0.1
    expected = solve_ivp(lambda t, z: (z[1], 9.81 * np.cos(z[0]) / inertia), (0.0, 0.3), (0.0, 0.0), rtol=1e-10)
    np.testing.assert_allclose(found["ja"][-1], expected.y[0, -1], rtol=1e-6)
    np.testing.assert_allclose(found["jb"], 2 * found["ja"], rtol=1e-12)


def test_constraints_and_closures_of_a_base_class_that_would_be_lost_are_refused_by_name():
    with pytest.raises(
        al.ProblemError, match=r"Odd\.constraint_names leaves out \['length', 'height'\] of SliderCrank"
    ):
        type("Odd", (SliderCrank,), {"constraint_names": ("gear",), "constraint": lambda self, q: (q[0],)})
    odd = type("Odd", (ClosedTree,), {"closures": lambda self: ()})()
    with pytest.raises(al.ProblemError, match=r"Odd\.closures leaves out \['pin'\] of ClosedTree"):
        al.ForwardDynamics(odd)


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [
        ("constraints_names", ("a",), "constraint_names"),
        ("velocities", ("a",), "velocity_names"),
        ("constraints", ("a",), "constraint_names"),
        ("force", lambda self, q, v: v, "forces"),
        ("loads", lambda self, q, v, t: v, "load"),
    ],
)
def test_a_name_that_a_class_does_not_know_is_refused_where_the_class_is_made(name, value, right):
    parts = {"names": ("x",), "mass_matrix": lambda self, q: np.eye(1), name: value}
    with pytest.raises(al.ProblemError, match=rf"Odd\.{name} .*{right}"):
        type("Odd", (al.Mechanical,), parts)


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


REST, MOVE = (al.PowerSeries(start=(0.0, 0.0), end=(end, 0.0)) for end in (0.0, 1.0))


def test_a_motion_that_a_mechanism_cannot_make_is_refused_with_the_rate_that_it_misses():
    sideways = al.InverseDynamics(Knife(), motion={"x": REST, "y": MOVE, "phi": REST})
    # A cubic from rest to rest in a second is fastest in the middle.
    assert "at t = 0.5 s a rate misses velocity_map(q) times the velocities by 1.5" in sideways.diagnose(
        al.Grid(1.0, 4)
    )
    with pytest.warns(al.SimulationWarning, match="at t = 0.5 s a rate misses velocity_map.* by 1.5"):
        al.simulate(sideways, al.Grid(1.0, 4))
    forward = simulate(al.InverseDynamics(Knife(), motion={"x": MOVE, "y": REST, "phi": REST}), al.Grid(1.0, 4))
    np.testing.assert_allclose(forward["push"], 6.0 - 12.0 * np.linspace(0.0, 1.0, 5), rtol=0, atol=1e-12)
    assert forward["motion_error"].max() < 1e-12


def state(crank=0.5, rate=2.0):
    """A state of the slider-crank, by hand."""
    rod = -np.arcsin(np.sin(crank) / 3)
    rod_rate = -0.1 * np.cos(crank) * rate / (0.3 * np.cos(rod))
    posture = {"crank": crank, "rod": rod, "slider": 0.1 * np.cos(crank) + 0.3 * np.cos(rod)}
    slider_rate = -0.1 * np.sin(crank) * rate - 0.3 * np.sin(rod) * rod_rate
    return posture, {"crank_rate": rate, "rod_rate": rod_rate, "slider_rate": slider_rate}


@pytest.mark.slow
def test_a_complete_state_is_a_start_as_it_is_and_published_digits_are_completed():
    posture, rates = state()
    whole = posture | rates
    first = simulate(al.ForwardDynamics(SliderCrank(), start=whole, guess={"crank": 9.0}), al.Grid(0.1, 5))
    for name, value in whole.items():
        np.testing.assert_allclose(first[name][0], value, rtol=0, atol=1e-14)
    rounded = {name: round(value, 3) for name, value in whole.items()}
    first = simulate(al.ForwardDynamics(SliderCrank(), start=rounded), al.Grid(0.1, 5))
    for name, value in rounded.items():
        np.testing.assert_allclose(first[name][0], value, rtol=0, atol=1e-3)
    assert first["constraint_error"].max() < 1e-14
    # As of a simulator whose constraints yield.
    yielding = whole | {"slider": whole["slider"] + 5e-3}
    first = simulate(al.ForwardDynamics(SliderCrank(), start=yielding), al.Grid(0.1, 5))
    for name, value in yielding.items():
        np.testing.assert_allclose(first[name][0], value, rtol=0, atol=2e-2)
    assert first["constraint_error"].max() < 1e-14
