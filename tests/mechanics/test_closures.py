"""Closed loops of bodies: random chains against MuJoCo's matrices, spatial loops, constraints that depend on time."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from closed_loops import ClosedTree
from double_pendulum import simulate
from mujoco_trees import orders, random_tree
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import aleator as al
from aleator.mechanics._constraints import Bound, Saddle, jacobian_of
from aleator.mechanics._mechanical import constraint_of
from aleator.mechanics._multibody import Multibody
from aleator.mechanics._partial import Partition, Prescribed, solved
from compiling import answers, compiled

CHAINS = {
    "a tree with two loops": (
        ["revolute", "prismatic", "ball", "revolute", "revolute", "prismatic"],
        [-1, 0, 1, 0, 3, -1],
        [(2, 4, "ball"), (5, 4, "prismatic across")],
    ),
    "a free body on a hinge": (["free", "revolute", "ball"], [-1, 0, 1], [(2, -1, "revolute")]),
}


class Loops(Multibody):
    given: tuple
    joined: tuple

    def bodies(self):
        return self.given

    def closures(self):
        return self.joined


def frames_at(tree, q, ends, random):
    """A closure's frame anywhere on its parent, and the same frame as its child sees it in the posture `q`."""
    poses = {None: (np.eye(3), np.zeros(3)), **{name: tuple(pose) for name, pose in tree.poses(jnp.asarray(q)).items()}}
    (first, at), (second, child_at) = (map(np.asarray, poses[end]) for end in ends)
    position, turn = 0.4 * random.normal(size=3), Rotation.random(random_state=random).as_matrix()
    where, axes = at + first @ position, first @ turn
    return {
        "position": position,
        "orientation": turn,
        "child_position": second.T @ (where - child_at),
        "child_orientation": second.T @ axes,
    }, (where, axes)


@pytest.mark.slow
@pytest.mark.parametrize("case", CHAINS)
def test_accelerations_and_multipliers_solve_the_saddle_point_system_of_mujoco_s_matrices(case):
    kinds, parents, loops = CHAINS[case]
    random = np.random.default_rng(list(CHAINS).index(case))
    tree, mj = random_tree(kinds, parents, 20 + list(CHAINS).index(case))
    q, v = np.asarray(tree.normalised(jnp.asarray(random.normal(size=mj.nq)))), random.normal(size=mj.nv)
    joints = {"ball": al.joints.Ball(), "revolute": al.joints.Revolute("z"), "prismatic across": al.joints.Ball()}
    closures, rows, ends = [], [], []
    for k, (i, j, kind) in enumerate(loops):
        pair = f"b{i}", None if j < 0 else f"b{j}"
        given, frame = frames_at(tree, q, pair, random)
        closures.append(al.joints.Closure(f"c{k}", parent=pair[0], child=pair[1], joint=joints[kind], **given))
        rows.append(frame)
        ends.append((i, j))
    model = Loops(tree.given, tuple(closures))

    @compiled
    def moving(q, v, torque):
        bound = Bound(model, q)
        v = v - Saddle(model.mass_matrix(q), bound.G).least(bound.rate(v))
        every = Partition((), (), tuple(range(mj.nv)), mj.nq, mj.nv, mj.nv, 0)
        return solved(model, every, Prescribed(*[jnp.zeros(0)] * 3, torque), q, v)

    torque = random.normal(size=mj.nv)
    found = jax.tree.map(np.asarray, moving(q, v, torque))
    np.testing.assert_allclose(found.q, q, atol=1e-12)
    expected = by_mujoco(tree, mj, found.q, found.v, torque, list(zip(ends, rows, closures, strict=True)))
    np.testing.assert_allclose(expected["rate"], 0.0, atol=1e-11)
    scale = np.abs(expected["v_dot"]).max()
    np.testing.assert_allclose(found.v_dot, expected["v_dot"], rtol=1e-9, atol=1e-9 * scale)
    multipliers = expected["multipliers"]
    np.testing.assert_allclose(found.multipliers, multipliers, rtol=1e-9, atol=1e-9 * np.abs(multipliers).max())


def by_mujoco(tree, mj, q, v, torque, loops):
    """The system of equation (6) from MuJoCo's mass matrix, bias and Jacobians, solved by NumPy, in our order."""
    data = mujoco.MjData(mj)
    positions, speeds = orders(tree, mj)
    data.qpos[positions], data.qvel[speeds] = q, v
    mujoco.mj_forward(mj, data)
    M = np.zeros((mj.nv, mj.nv))
    mujoco.mj_fullM(mj, data, M)
    force = np.zeros(mj.nv)
    force[speeds] = torque
    force += data.qfrc_passive - data.qfrc_bias
    G, gamma = (np.concatenate(parts) for parts in zip(*(_rows(mj, data, *one) for one in loops), strict=True))
    m = len(G)
    solved = np.linalg.solve(np.block([[M, G.T], [G, np.zeros((m, m))]]), np.concatenate([force, gamma]))
    return {"v_dot": solved[: mj.nv][speeds], "multipliers": solved[mj.nv :], "rate": G @ data.qvel}


def _rows(mj, data, ends, frame, closure):
    """Rows of `G` and `γ` of one closure, where its frames coincide."""
    where, axes = frame
    (Jp, Jr, dp, dr, w), (Kp, Kr, ep, er, u) = (_ends(mj, data, end, where) for end in ends)
    point, drift = axes.T @ (Jp - Kp), axes.T @ (dp - ep)
    if isinstance(closure.joint, al.joints.Ball):
        return point, -drift
    # The axis on the child beside two directions on the parent: second derivatives of their products.
    axis, turns, rates = axes[:, 2], [], []
    for direction in (axes[:, 1], -axes[:, 0]):
        turns.append(np.cross(direction, axis) @ (Jr - Kr) * 1.0)
        first = np.cross(dr, direction) + np.cross(w, np.cross(w, direction))
        second = np.cross(er, axis) + np.cross(u, np.cross(u, axis))
        rates.append(first @ axis + 2 * np.cross(w, direction) @ np.cross(u, axis) + direction @ second)
    return np.vstack([point, *turns]), -np.concatenate([drift, rates])


def _ends(mj, data, index, where):
    """Jacobians of a point and a turn, what they change by without acceleration, and the angular velocity."""
    if index < 0:
        zero = np.zeros((3, mj.nv))
        return zero, zero, np.zeros(3), np.zeros(3), np.zeros(3)
    body = mj.body(f"b{index}").id
    jacobians = [np.zeros((3, mj.nv)) for _ in range(4)]
    mujoco.mj_jac(mj, data, jacobians[0], jacobians[1], where, body)
    mujoco.mj_jacDot(mj, data, jacobians[2], jacobians[3], where, body)
    Jp, Jr, dp, dr = jacobians
    return Jp, Jr, dp @ data.qvel, dr @ data.qvel, Jr @ data.qvel


class Winch(al.Mechanical):
    """A weight on a rope that is let out: `x² + y² = length(t)²`."""

    names = ("x", "y")
    actuator_names = ()
    constraint_names = ("rope",)

    length: al.Number = 1.0

    def mass_matrix(self, q):
        return 2.0 * jnp.eye(2)

    def forces(self, q, v):
        return jnp.array([0.0, 2.0 * 9.81])

    def actuation(self, q):
        return jnp.zeros((2, 0))

    def constraint(self, q):
        return (jnp.sqrt(q @ q) - self.length,)


def test_a_rope_that_is_let_out_moves_as_in_polar_coordinates():
    model = Winch(length=al.PowerSeries(start=(1.0, 0.3, 0.4), end=(1.5,)))
    grid = al.Grid(1.0, 200)
    system = al.ForwardDynamics(model, start={"x": 0.6}, guess={"y": -0.8})
    found = simulate(system, grid)

    def rates(t, z):
        length, rate = 1.0 + 0.3 * t + 0.2 * t**2, 0.3 + 0.4 * t
        return z[1], -(2 * rate * z[1] + 9.81 * np.sin(z[0])) / length

    # The velocity nearest to rest is that along the rope.
    start = (np.arcsin(0.6), 0.0)
    angle, turning = solve_ivp(rates, (0.0, 1.0), start, t_eval=np.asarray(grid.times), rtol=1e-11, atol=1e-12).y
    times = np.asarray(grid.times)
    length = 1.0 + 0.3 * times + 0.2 * times**2
    np.testing.assert_allclose(found["x"], length * np.sin(angle), atol=1e-8)
    np.testing.assert_allclose(found["y"], -length * np.cos(angle), atol=1e-8)
    # The pull of the rope: weight and centrifugal force, less what the rope gives way.
    tension = 2.0 * (9.81 * np.cos(angle) + length * turning**2 - 0.4)
    np.testing.assert_allclose(found["rope_multiplier"], tension, atol=1e-6)


def end_of_rope(numbers):
    system = al.ForwardDynamics(Winch(length=numbers[0]), start={"x": numbers[1]}, guess={"y": -1.0})
    found = al.simulate(system, al.Grid(0.5, 60), only=("y", "rope_multiplier"))
    return jnp.stack([found["y"][0], found["y"][-1], found["rope_multiplier"][-1]])


@pytest.mark.slow
def test_derivatives_by_numbers_are_those_of_finite_differences():
    functions = [end_of_rope]
    for _ in range(2):
        functions.append(jax.jacfwd(functions[-1]))
    all_of = compiled(lambda x: [one(x) for one in functions])
    numbers, h = np.array([1.0, 0.3]), 1e-5
    found = [np.asarray(one) for one in all_of(numbers)]
    for i, step in enumerate(h * np.eye(2)):
        ahead, behind = ([np.asarray(one) for one in all_of(numbers + sign * step)] for sign in (1, -1))
        for k in range(2):
            slope = (ahead[k] - behind[k]) / (2 * h)
            np.testing.assert_allclose(found[k + 1][..., i], slope, rtol=1e-6, atol=1e-6 * np.abs(found[k + 1]).max())


def test_the_jacobian_of_closures_is_the_derivative_of_what_is_left_of_them():
    joints = (al.joints.Revolute("y"), al.joints.Prismatic((1.0, 2.0, -0.5)), al.joints.Fixed(), al.joints.Ball())
    tree, mj = random_tree(["revolute", "ball", "prismatic"], [-1, 0, -1], 3)
    closures = tuple(
        al.joints.Closure(f"c{k}", parent="b1", child="b2", joint=joint, orientation=(0.3, -0.2, 0.5))
        for k, joint in enumerate(joints)
    )
    model = Loops(tree.given, closures)
    q = model.normalised(np.random.default_rng(5).normal(size=mj.nq))

    @compiled
    def both(q):
        return model.closing_jacobian(q), jax.jacfwd(model.closing)(q) @ model.velocity_map(q)

    ours, expected = both(q)
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12)
    assert len(model.constraints) == len(ours) == 5 + 5 + 6 + 3
    assert ClosedTree().constraints == ("pin_x", "pin_y")


class FourBar(al.Multibody):
    """A crank that turns a rocker by a coupler, and a wheel."""

    def bodies(self):
        hinge = {"joint": al.joints.Revolute("z"), "mass": 0.4, "inertia": (0.0, 0.0, 0.003)}
        return (
            al.Body("crank", **hinge),
            al.Body("coupler", parent="crank", position=(0.1, 0.0, 0.0), **hinge),
            al.Body("rocker", position=(0.4, 0.0, 0.0), **hinge),
            al.Body("wheel", **hinge),
        )

    def closures(self):
        ends = {"position": (0.35, 0.0, 0.0), "child_position": (0.3, 0.0, 0.0)}
        hinge = al.joints.Revolute("z")
        return (al.joints.Closure("pin", parent="coupler", child="rocker", joint=hinge, planar=True, **ends),)


class Geared(FourBar):
    constraint_names = ("gear",)

    def constraint(self, q):
        return (q[3] - 2 * q[0],)


class Coupled(FourBar):
    def closures(self):
        gear = al.joints.Coupling("gear", follower="wheel", leader="crank", coefficients=(0.0, 2.0, 0.0, 0.0, 0.0))
        return (*super().closures(), gear)


@pytest.mark.slow
def test_equations_of_ones_own_and_couplings_stand_beside_loops():
    q = jnp.array([0.4, -0.1, 1.2, 0.5])
    for model in (Geared(), Coupled()):
        assert model.constraints == ("pin_x", "pin_y", "gear")
        # By hand: what the coupler's end and the rocker's end are apart, along the coupler; and the gear.
        ends = [
            np.array([0.1 * np.cos(0.4) + 0.35 * np.cos(0.3), 0.1 * np.sin(0.4) + 0.35 * np.sin(0.3)]),
            np.array([0.4 + 0.3 * np.cos(1.2), 0.3 * np.sin(1.2)]),
        ]
        along = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
        expected = [*along @ (ends[0] - ends[1]), 0.5 - 2 * 0.4]
        left, slopes = answers(model, [partial(of, q=q) for of in (constraint_of, jacobian_of)])
        np.testing.assert_allclose(left, expected, atol=1e-14)
        np.testing.assert_allclose(slopes[2], [-2.0, 0.0, 0.0, 1.0], atol=1e-14)
