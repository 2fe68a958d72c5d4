from functools import cache

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


@pytest.mark.parametrize("seed", range(3))
def test_the_matrices_of_a_two_link_arm_are_those_of_its_lagrangian(seed):
    random = np.random.default_rng(seed)
    q, v, force = random.normal(size=(3, 2))
    payload, length = random.uniform(0.5, 2.0, 2)
    mass, bias = lagrange()(*q, *v, payload, length)
    bias = bias.ravel()

    @compiled
    def all_of(arm, q, v, force):
        return arm.mass_matrix(q), arm.bias(q, v), arm.forward_dynamics(q, v, force)

    ours = all_of(Arm(payload=payload, length=length), q, v, force)
    for one, by_hand in zip(ours, (mass, bias, np.linalg.solve(mass, force - bias)), strict=True):
        np.testing.assert_allclose(one, by_hand, rtol=1e-12, atol=1e-12)


def test_coordinates_and_speeds_are_named_by_bodies_even_of_an_uncertain_model():
    uncertain = Arm(payload=al.Normal(1.0, 0.1), length=al.Decision(0.8, 0.5, 1.0))
    assert uncertain.coordinates == ("upper", "fore")
    assert uncertain.speeds == ("upper_rate", "fore_rate")
    realised = realise(uncertain, jnp.array([2.0]), jnp.array([0.9]))
    tip = compiled(lambda arm: arm.point(jnp.zeros(2), "load"))(realised)
    np.testing.assert_allclose(tip, [1.8, 0.0, 0.0], rtol=1e-15)
    assert compiled(lambda arm: arm.mass_matrix(jnp.zeros(2)))(realised).shape == (2, 2)
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
@compiled
def flight():
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

    path = jax.lax.scan(step, (q, v), None, length=400)[1]
    return jax.tree.map(lambda first, later: jnp.concatenate([first[None], later]), (q, v), path)


@pytest.mark.slow
def test_a_passive_tree_without_dampers_keeps_its_energy():
    q, v = flight()
    energy = compiled(jax.vmap(lambda q, v: FLOATING.kinetic_energy(q, v) + FLOATING.potential_energy(q)))(q, v)
    kinetic = compiled(jax.vmap(FLOATING.kinetic_energy))(q, v)
    assert np.ptp(kinetic) > 1.0
    assert np.ptp(energy) < 1e-8


def test_a_thrown_tree_falls_with_its_centre_of_mass():
    q, _ = flight()

    def centre_of_mass(q):
        masses = {body.name: body.mass for body in FLOATING.given}
        local = {body.name: body.center for body in FLOATING.given}
        points = {name: FLOATING.point(q, name, local[name]) for name in masses}
        return sum(masses[name] * point for name, point in points.items()) / sum(masses.values())

    centre = np.asarray(compiled(jax.vmap(centre_of_mass))(q))
    times = 1e-3 * np.arange(len(centre))
    start = np.linalg.lstsq(np.stack([np.ones_like(times), times], 1), centre + np.outer(times**2, [0, 0, 4.905]))[0]
    parabola = start[0] + np.outer(times, start[1]) - np.outer(times**2, [0, 0, 4.905])
    np.testing.assert_allclose(centre, parabola, rtol=0, atol=1e-9)


def test_quaternions_keep_their_length_along_velocities_and_are_brought_to_it():
    q, v = (np.asarray(path) for path in flight())
    for start in (3, 8):
        np.testing.assert_allclose(np.linalg.norm(q[:, start : start + 4], axis=1), 1.0, rtol=0, atol=1e-9)
    scaled = FLOATING.normalised(jnp.asarray(q[-1]).at[3:7].multiply(3.0).at[8:].multiply(0.1))
    np.testing.assert_allclose(scaled[np.r_[:3, 7]], q[-1, np.r_[:3, 7]], rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(scaled[3:7]), 1.0, rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(scaled[8:]), 1.0, rtol=1e-15)
    unturned = FLOATING.normalised(jnp.zeros(12))
    np.testing.assert_array_equal(np.flatnonzero(unturned), [3, 8])
    np.testing.assert_array_equal(jax.jacfwd(FLOATING.normalised)(unturned)[3], np.zeros(12))
    change = FLOATING.velocity_map(jnp.asarray(q[0])) @ v[0]
    assert abs(q[0, 3:7] @ change[3:7]) < 1e-15
    assert abs(q[0, 8:] @ change[8:]) < 1e-15


@pytest.mark.parametrize("joint", [Revolute("z"), Prismatic("x"), Ball()])
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
    q, v = jnp.array([-np.pi / 2]), jnp.array([2.0])
    np.testing.assert_allclose(tree.point(q, "wall", (1, 0, 0)), [1, 3, 3], atol=1e-15)
    np.testing.assert_allclose(tree.point(q, "door", (1, 0, 0)), [2, 2, 3], atol=1e-15)
    np.testing.assert_allclose(tree.point_velocity(q, v, "wall"), np.zeros(3))
    np.testing.assert_allclose(tree.point_velocity(q, v, "door", (1, 0, 0)), [0, 2, 0], atol=1e-15)


def body(name="one", **changes):
    return Body(name, **({"joint": Revolute("z"), "mass": 1.0} | changes))


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (lambda: (body(), body()), "'one'.* occur twice"),
        (lambda: (body(parent="two"),), "parents .'two'., which are no bodies"),
        (lambda: (body("a", parent="b"), body("b", parent="a")), "cycle"),
        (lambda: (body(mass=-1.0),), "mass that is not negative; received -1.0"),
        (lambda: (body(mass=np.nan),), "mass: expected finite numbers"),
        (lambda: (body(inertia=(1, 1, -1)),), "not negative; received -1"),
        (lambda: (body(inertia=(1, 1, 3)),), "beyond the sum of the other two"),
        (lambda: (body(inertia=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]),), "expected a symmetric matrix"),
        (lambda: (body(inertia=(1, 1)),), "inertia: expected numbers of shape .3,. or .6,. or .3, 3."),
        (lambda: (body(orientation=2 * np.eye(3)),), "expected a rotation matrix"),
        (lambda: (body(position="far"),), "position: expected numbers"),
        (lambda: (body(joint=Revolute("w")),), "axis 'x', 'y' or 'z'"),
        (lambda: (body(joint=Prismatic((0, 0, 0))),), "nonzero"),
        (lambda: "one", "returns a tuple of al.Body"),
    ],
)
def test_bodies_that_make_no_tree_are_refused_in_words(bodies, message):
    with pytest.raises(ProblemError, match=message):
        Tree(bodies()).bias(jnp.zeros(1), jnp.zeros(1))


def test_a_body_needs_a_name_and_a_joint():
    with pytest.raises(ProblemError, match="expected a name"):
        body("")
    with pytest.raises(ProblemError, match="expected a joint"):
        body(joint="hinge")
    with pytest.raises(ProblemError, match="There is no body 'two'"):
        Tree((body(),)).point(jnp.zeros(1), "two")
