from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import simulate
from mujoco_trees import Tree
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import aleator as al
from aleator.joints import Ball, Free, Prismatic, Revolute
from aleator.uncertainty import placements, realise
from compiling import answers, compiled


def test_an_uncertain_body_may_be_a_field_itself():
    model = Tree((al.Body("slider", joint=Prismatic("x"), mass=al.Uniform(2.0, half_width=0.5)),))
    assert model.coordinates == ("slider",)
    assert model.speeds == ("slider_rate",)
    assert len(placements(model).germ_names) == 1
    (mass,) = answers(model, [lambda model: realise(model, jnp.array([0.5]), jnp.zeros(0)).mass_matrix(jnp.zeros(1))])
    np.testing.assert_allclose(mass, [[2.25]], rtol=1e-14)


FLOATING = Tree((al.Body("base", joint=Free(), mass=1.0), al.Body("head", parent="base", joint=Ball(), mass=1.0)))


def test_quaternions_are_brought_to_length_one_and_zero_is_no_turn():
    @compiled
    def normalised(q):
        return FLOATING.normalised(q), jax.jacfwd(FLOATING.normalised)(q)

    q = np.array([1.0, -2.0, 3.0, 0.0, 3.0, 0.0, -4.0, 0.1, 0.0, 0.0, 0.0])
    expected = [1.0, -2.0, 3.0, 0.0, 0.6, 0.0, -0.8, 1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(normalised(q)[0], expected, rtol=1e-15)
    unturned, slope = (np.asarray(one) for one in normalised(np.zeros(11)))
    np.testing.assert_array_equal(np.flatnonzero(unturned), [3, 7])
    assert np.isfinite(slope).all()


def test_a_joint_that_moves_no_inertia_gives_no_acceleration_rather_than_a_wrong_one():
    tip = al.Body("tip", parent="upper", joint=Revolute("z"), mass=0.0)
    tree = Tree((al.Body("upper", joint=Revolute("z"), mass=1.0, center=(1, 0, 0)), tip))
    assert not np.isfinite(compiled(tree.forward_dynamics)(*np.ones((3, 2)))).any()


def body(name="one", **changes):
    return al.Body(name, **({"joint": Revolute("z"), "mass": 1.0} | changes))


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (lambda: (body("a", parent="b"), body("b", parent="a")), "cycle"),
        (lambda: (body(inertia=(1, 1, 3)),), "beyond the sum of the other two"),
    ],
)
def test_bodies_that_make_no_tree_are_refused_in_words(bodies, message):
    with pytest.raises(al.ProblemError, match=message):
        Tree(bodies()).bias(jnp.zeros(1), jnp.zeros(1))


# --- A free rigid body as a mechanical system of one's own, and bodies on joints, by quaternions ----------------------


INERTIA = np.array([0.5, 1.1, 1.7])
SPIN = np.array([0.9, 2.1, -0.6])
TILT = Rotation.from_euler("ZYX", [0.4, -0.3, 0.7])
GRID = al.Grid(1.0, 500)
BODY = ("body_x", "body_y", "body_z")


class Body(al.Mechanical):
    """Euler's equations in the body's axes, whatever the coordinates are."""

    velocity_names = BODY
    actuator_names = ("couple_x", "couple_y", "couple_z")

    inertia: al.Number = (0.5, 1.1, 1.7)

    def mass_matrix(self, q):
        return jnp.diag(jnp.array(self.inertia))

    def forces(self, q, v):
        return jnp.cross(v, jnp.array(self.inertia) * v)

    def actuation(self, q):
        return np.eye(3)


class Quaternion(Body):
    """Of length one, its real part first."""

    names = ("w", "x", "y", "z")

    def velocity_map(self, q):
        w, x, y, z = q
        return 0.5 * jnp.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])

    def normalised(self, q):
        return q / jnp.linalg.norm(q)


@cache
def tumbling():
    start = dict(zip(Quaternion.names, 2.5 * TILT.as_quat(scalar_first=True), strict=True))
    return simulate(al.ForwardDynamics(Quaternion(), start=start | dict(zip(BODY, SPIN, strict=True))), GRID)


def rotations(found):
    return Rotation.from_quat(np.stack([found[name] for name in "wxyz"], axis=1), scalar_first=True)


def test_a_body_without_torque_spins_by_euler_s_equations():
    def rates(t, v):
        return -np.cross(v, INERTIA * v) / INERTIA

    found = tumbling()
    spin = np.stack([found[name] for name in BODY], axis=1)
    expected = solve_ivp(rates, (0, 1), SPIN, "DOP853", GRID.fractions, rtol=1e-12, atol=1e-12).y.T
    np.testing.assert_allclose(spin, expected, rtol=0, atol=1e-8)
    assert np.ptp(spin, axis=0).min() > 0.1
    momentum = rotations(found).apply(INERTIA * spin)
    np.testing.assert_allclose(momentum, np.tile(TILT.apply(INERTIA * SPIN), (501, 1)), rtol=0, atol=1e-8)


def test_quaternions_are_of_length_one_in_outputs_and_their_rates_along_the_sphere():
    found = tumbling()
    q, q_dot, q_ddot = (np.stack([found[name + end] for name in "wxyz"], 1) for end in ("", "_rate", "_acceleration"))
    np.testing.assert_allclose((q**2).sum(axis=1), 1.0, rtol=1e-13)
    np.testing.assert_allclose((q * q_dot).sum(axis=1), 0.0, rtol=0, atol=1e-13)
    np.testing.assert_allclose((q * q_ddot + q_dot**2).sum(axis=1), 0.0, rtol=0, atol=1e-12)
    h = 1 / 500
    np.testing.assert_allclose(q_dot[1:-1], (q[2:] - q[:-2]) / (2 * h), rtol=0, atol=1e-4)
    np.testing.assert_allclose(q_ddot[1:-1], (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2, rtol=0, atol=1e-4)


class Top(al.Multibody):
    gravity = (0.0, 0.0, 0.0)

    def bodies(self):
        return (al.Body("b", joint=al.joints.Ball(), mass=1.0, inertia=(0.1, 0.2, 0.25)),)


def test_components_of_a_quaternion_that_a_start_leaves_out_are_those_of_no_turn():
    start = al.ForwardDynamics(Top(), start={"b_x": 0.05}).initial()["q"]
    np.testing.assert_allclose(start, np.array([1.0, 0.05, 0.0, 0.0]) / np.hypot(1.0, 0.05), rtol=1e-15)
    half_turn = al.ForwardDynamics(Top(), start={"b_w": 0.0, "b_x": 0.05}).initial()["q"]
    np.testing.assert_allclose(half_turn, [0.0, 1.0, 0.0, 0.0])
