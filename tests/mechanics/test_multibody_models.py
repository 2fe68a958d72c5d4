from functools import cache
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy as sp
from mujoco_trees import Tree

import aleator as al
from aleator._core.errors import ProblemError
from aleator.mechanics._body import Body
from aleator.mechanics._joints import Ball, Fixed, Free, Prismatic, Revolute
from aleator.mechanics._multibody import Multibody
from aleator.uncertainty import placements, realise
from compiling import compiled


class Arm(Multibody):
    """Two rods in the plane, one spring and damper, and a load at the tip. Gravity along -y."""

    payload: al.Number = al.parameter("kg", positive=True)
    length: al.Number = 0.8
    gravity: tuple = (0.0, -9.81, 0.0)

    def bodies(self):
        far = (self.length / 2, 0.0, 0.0)
        elbow = Revolute("z", damping=0.1, stiffness=2.0, rest=0.3)
        return (
            Body("load", parent="fore", joint=Fixed(), position=(self.length, 0, 0), mass=self.payload),
            Body("upper", joint=Revolute("z"), mass=1.5, center=far, inertia=(0, 0, 1.5 * self.length**2 / 12)),
            Body("fore", parent="upper", joint=elbow, position=(self.length, 0, 0), mass=1.1, center=far),
        )


@cache
def lagrange():
    """Mass matrix and bias of the arm from its Lagrangian, by SymPy."""
    t, length, payload = sp.symbols("t length payload")
    a, b = sp.Function("a")(t), sp.Function("b")(t)
    x, y = length * sp.cos(a), length * sp.sin(a)
    places = {
        1.5: (x / 2, y / 2),
        1.1: (x + length / 2 * sp.cos(a + b), y + length / 2 * sp.sin(a + b)),
        payload: (x + length * sp.cos(a + b), y + length * sp.sin(a + b)),
    }
    speed = {mass: sum(part.diff(t) ** 2 for part in place) for mass, place in places.items()}
    kinetic = sum(mass * speed[mass] / 2 for mass in places) + 1.5 * length**2 / 24 * a.diff(t) ** 2
    potential = sum(9.81 * mass * place[1] for mass, place in places.items()) + (b - 0.3) ** 2
    equations = sp.Matrix(
        [(kinetic - potential).diff(one.diff(t)).diff(t) - (kinetic - potential).diff(one) for one in (a, b)]
    )
    accelerations = [a.diff(t, 2), b.diff(t, 2)]
    mass = equations.jacobian(accelerations)
    bias = equations.subs(dict.fromkeys(accelerations, 0)) + sp.Matrix([0, 0.1 * b.diff(t)])
    plain = sp.symbols("a b a_rate b_rate")
    names = dict(zip((a.diff(t), b.diff(t), a, b), (plain[2], plain[3], plain[0], plain[1]), strict=True))
    return sp.lambdify((*plain, payload, length), [part.subs(names) for part in (mass, bias)])


@compiled
def all_of(arm, q, v, force):
    return arm.mass_matrix(q), arm.bias(q, v), arm.forward_dynamics(q, v, force), arm.point(jnp.zeros(2), "load")


@pytest.mark.parametrize("seed", range(3))
def test_the_matrices_of_a_two_link_arm_are_those_of_its_lagrangian(seed):
    random = np.random.default_rng(seed)
    q, v, force = random.normal(size=(3, 2))
    payload, length = random.uniform(0.5, 2.0, 2)
    mass, bias = lagrange()(*q, *v, payload, length)
    bias = bias.ravel()

    *ours, tip = all_of(Arm(payload=payload, length=length), q, v, force)
    np.testing.assert_allclose(tip, [2 * length, 0.0, 0.0], rtol=1e-15)
    for one, by_hand in zip(ours, (mass, bias, np.linalg.solve(mass, force - bias)), strict=True):
        np.testing.assert_allclose(one, by_hand, rtol=1e-12, atol=1e-12)


def test_coordinates_and_speeds_are_named_by_bodies_even_of_an_uncertain_model():
    uncertain = Arm(payload=al.Normal(1.0, 0.1), length=al.Decision(0.8, 0.5, 1.0))
    assert uncertain.coordinates == ("upper", "fore")
    assert uncertain.speeds == ("upper_rate", "fore_rate")
    assert placements(uncertain).germ_names == ("payload",)


def test_an_uncertain_body_may_be_a_field_itself():
    body = Body("slider", joint=Prismatic("x"), mass=al.Uniform(2.0, half_width=0.5))
    model = Tree((body,))
    assert model.coordinates == ("slider",)
    mass = realise(model, jnp.array([0.5]), jnp.zeros(0)).mass_matrix(jnp.zeros(1))
    np.testing.assert_allclose(mass, [[2.25]], rtol=1e-14)


def test_ball_and_free_joints_name_each_of_their_coordinates():
    tree = Tree((Body("base", joint=Free(), mass=1.0), Body("head", parent="base", joint=Ball(), mass=1.0)))
    assert tree.coordinates[:7] == ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
    assert tree.coordinates[7:] == ("head_w", "head_x", "head_y", "head_z")
    assert len(tree.speeds) == len(set(tree.speeds)) == 9
    assert len(set(tree.coordinates + tree.speeds + tree.actuators)) == 11 + 9 + 9


def test_a_spinning_top_precesses_steadily_at_the_textbook_rate():
    # A heavy top with its axis level: Ω = m g r / (C n).
    mass, reach, spin, across, along = 1.3, 0.4, 60.0, 0.03, 0.05
    top = Tree((Body("top", joint=Ball(), mass=mass, center=(0, 0, reach), inertia=(across, across, along)),))
    precession = mass * 9.81 * reach / (along * spin)
    # The body's z lies along the world's x, and the world's z along the body's -x.
    q = jnp.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0])
    v = jnp.array([-precession, 0.0, spin])
    rate = compiled(top.forward_dynamics)(q, v, jnp.zeros(3))
    # The angular velocity Ω e_z + n e_axis turns with the axis: its rate is Ω e_z × n e_axis.
    np.testing.assert_allclose(rate, np.cross([-precession, 0, 0], [0, 0, spin]), rtol=1e-13, atol=1e-10)


FLOATING = Tree(
    (
        Body("base", joint=Free(), mass=2.0, center=(0.1, 0, 0), inertia=(0.3, 0.4, 0.5)),
        Body("arm", parent="base", joint=Revolute((1, 1, 0)), position=(0.2, 0, 0.1), mass=0.7, center=(0.3, 0, 0)),
        Body("ball", parent="arm", joint=Ball(), position=(0.6, 0, 0), mass=0.5, inertia=(0.1, 0.1, 0.15)),
    )
)


@cache
def flight():
    return tuple(map(np.asarray, flown()))


@compiled
def flown():
    """A floating base with an arm, thrown: coordinates and speeds over 0.4 s, in 400 steps of Runge-Kutta."""
    random = np.random.default_rng(3)
    q = FLOATING.normalised(jnp.asarray(random.normal(size=12)))
    v = jnp.asarray(random.normal(size=10))

    def rates(z):
        return FLOATING.velocity_map(z[0]) @ z[1], FLOATING.forward_dynamics(*z, jnp.zeros(10))

    def step(z, _):
        h = 1e-3

        def moved(slope, by):
            return jax.tree.map(lambda a, b: a + by * b, z, slope)

        k1 = rates(z)
        k2 = rates(moved(k1, h / 2))
        k3 = rates(moved(k2, h / 2))
        k4 = rates(moved(k3, h))
        total = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
        following = moved(total, h)
        return following, following

    def seen(q, v):
        kinetic, mass = FLOATING.kinetic_energy(q, v), sum(body.mass for body in FLOATING.given)
        centre = sum(body.mass * FLOATING.point(q, body.name, body.center) for body in FLOATING.given) / mass
        return q, v, kinetic, kinetic + FLOATING.potential_energy(q), centre, FLOATING.velocity_map(q) @ v

    path = jax.lax.scan(step, (q, v), None, length=400)[1]
    return jax.vmap(seen)(*path)


def test_a_thrown_tree_keeps_its_energy_and_falls_with_its_centre_of_mass():
    _, _, kinetic, energy, centre, _ = flight()
    assert np.ptp(kinetic) > 1.0
    assert np.ptp(energy) < 1e-8
    times = 1e-3 * np.arange(len(centre))
    fallen = centre + np.outer(times**2, [0, 0, 4.905])
    line = np.stack([np.ones_like(times), times], 1)
    np.testing.assert_allclose(fallen, line @ np.linalg.lstsq(line, fallen)[0], rtol=0, atol=1e-9)


def test_quaternions_keep_their_length_along_velocities_and_are_brought_to_it():
    q, *_, change = flight()
    for start in (3, 8):
        np.testing.assert_allclose(np.linalg.norm(q[:, start : start + 4], axis=1), 1.0, rtol=0, atol=1e-9)
        assert abs(q[0, start : start + 4] @ change[0, start : start + 4]) < 1e-15

    @compiled
    def normalised(q):
        return FLOATING.normalised(q), jax.jacfwd(FLOATING.normalised)(q)

    long = q[-1].copy()
    long[3:7] *= 3.0
    long[8:] *= 0.1
    scaled = np.asarray(normalised(long)[0])
    np.testing.assert_allclose(scaled[np.r_[:3, 7]], q[-1, np.r_[:3, 7]], rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(scaled[3:7]), 1.0, rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(scaled[8:]), 1.0, rtol=1e-15)
    unturned = np.asarray(normalised(np.zeros(12))[0])
    np.testing.assert_array_equal(np.flatnonzero(unturned), [3, 8])
    np.testing.assert_array_equal(normalised(unturned)[1][3], np.zeros(12))


@pytest.mark.parametrize("joint", [Revolute("z"), pytest.param(Ball(), marks=pytest.mark.slow)])
def test_a_joint_that_moves_no_inertia_gives_no_acceleration_rather_than_a_wrong_one(joint):
    tree = Tree(
        (
            Body("upper", joint=Revolute("z"), mass=1.0, center=(1, 0, 0)),
            Body("tip", parent="upper", joint=joint, mass=0.0),
        )
    )
    sizes = len(tree.coordinates), len(tree.speeds)
    acceleration = compiled(tree.forward_dynamics)(jnp.ones(sizes[0]), jnp.ones(sizes[1]), jnp.ones(sizes[1]))
    assert not np.isfinite(acceleration).any()


def test_a_ground_fixed_body_stays_and_carries_others():
    tree = Tree(
        (
            Body("wall", joint=Fixed(), position=(1, 2, 3), orientation=(0, 0, np.pi / 2), mass=5.0),
            Body("door", parent="wall", joint=Revolute((0, 0, 2)), mass=1.0),
        )
    )
    q, v, ahead = np.array([-np.pi / 2]), np.array([2.0]), (1, 0, 0)

    @compiled
    def all_of(q, v):
        points = [tree.point(q, name, ahead) for name in ("wall", "door")]
        return points, [tree.point_velocity(q, v, "wall"), tree.point_velocity(q, v, "door", ahead)]

    points, velocities = all_of(q, v)
    np.testing.assert_allclose(points, [[1, 3, 3], [2, 2, 3]], atol=1e-15)
    np.testing.assert_allclose(velocities, [[0, 0, 0], [0, 2, 0]], atol=1e-15)


def body(name="one", **changes):
    return Body(name, **({"joint": Revolute("z"), "mass": 1.0} | changes))


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (lambda: (body(), body()), "'one'.* occur twice"),
        (lambda: (body(parent="two"),), "parents .'two'., which are no bodies"),
        (lambda: (body("a", parent="b"), body("b", parent="a")), "cycle"),
        (lambda: (body(mass=-1.0),), "mass that is not negative; received -1.0"),
        (lambda: (body(inertia=(1, 1, -1)),), "not negative; received -1"),
        (lambda: (body(inertia=(1, 1, 3)),), "beyond the sum of the other two"),
        (lambda: (body(inertia=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]),), "expected a symmetric matrix"),
        (lambda: (body(orientation=2 * np.eye(3)),), "expected a rotation matrix"),
        (lambda: (body(joint=Revolute("w")),), "axis 'x', 'y' or 'z'"),
        (lambda: (body(joint=Prismatic((0, 0, 0))),), "nonzero"),
        (lambda: "one", "returns a tuple of al.Body"),
    ],
)
def test_bodies_that_make_no_tree_are_refused_in_words(bodies, message):
    with pytest.raises(ProblemError, match=message):
        Tree(bodies()).bias(jnp.zeros(1), jnp.zeros(1))


def test_units_are_told_by_joints_and_one_s_own_come_before_them():
    class Mixed(al.Multibody):
        units: ClassVar = {"lift_torque": "daN"}

        def bodies(self):
            return (
                al.Body("turn", joint=al.joints.Revolute("z"), mass=1.0, inertia=(0, 0, 1.0)),
                al.Body("lift", parent="turn", joint=al.joints.Prismatic("z"), mass=1.0),
                al.Body("head", parent="lift", joint=al.joints.Ball(), mass=1.0, inertia=(1.0, 1.0, 1.0)),
            )

    units = al.ForwardDynamics(Mixed()).units
    assert [units[f"turn{end}"] for end in ("", "_rate", "_torque")] == ["rad", "rad/s", "N·m"]
    assert [units[f"lift{end}"] for end in ("", "_rate", "_torque")] == ["m", "m/s", "daN"]
    assert [units[f"head_omega_x{end}"] for end in ("", "_torque")] == ["rad/s", "N·m"]
    assert "head_w" not in units


@pytest.mark.parametrize("part", ["damping", "armature"])
def test_a_damping_that_would_drive_a_joint_and_a_negative_armature_are_refused(part):
    class Driven(al.Multibody):
        number: al.Number = -1.0

        def bodies(self):
            return (al.Body("a", joint=al.joints.Prismatic("x", **{part: self.number}), mass=1.0),)

    for number in (-1.0, al.Uniform(0.5, half_width=0.6)):
        with pytest.raises(al.ProblemError, match=f"expected an? {part} that is not negative; received -"):
            al.Problem(al.ForwardDynamics(Driven(number=number)), grid=al.Grid(1.0, 4), minimize=al.terminal("a").mean)
