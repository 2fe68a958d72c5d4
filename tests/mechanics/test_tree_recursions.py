from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco_trees import orders, random_tree

from compiling import compiled

# The kinds of joints, and the parent of each body (-1: the ground).
TREES = {
    "branches": (
        ["revolute", "prismatic", "ball", "fixed", "revolute", "prismatic", "revolute"],
        [-1, 0, 0, 1, 3, 2, 2],
    ),
    "a free base": (["free", "ball", "fixed", "fixed", "revolute"], [-1, 0, 0, 2, 3]),
    "two roots": (["prismatic", "fixed", "revolute", "ball", "fixed"], [-1, -1, 1, 0, 3]),
}
STATES = 3
# Compiling is most of the work here: it is done without optimisation.


def dynamics(tree, q, v, given):
    """All that MuJoCo is asked for, at one state; `given` is an acceleration, or a force."""

    def at(q, v, given):
        return {
            "mass matrix": tree.mass_matrix(q),
            "bias": tree.bias(q, v),
            "inverse": tree.inverse_dynamics(q, v, given),
            "forward": tree.forward_dynamics(q, v, given),
            "poses": {name: tuple(pose) for name, pose in tree.poses(q).items()},
            "points": {body.name: tree.point(q, body.name, (0.3, -0.2, 0.5)) for body in tree.given},
            "velocities": {body.name: tree.point_velocity(q, v, body.name, (0.3, -0.2, 0.5)) for body in tree.given},
            "map": tree.velocity_map(q),
            "kinetic": tree.kinetic_energy(q, v),
            "potential": tree.potential_energy(q),
        }

    return jax.vmap(at)(q, v, given)


@pytest.fixture(
    scope="module",
    params=["branches", pytest.param("a free base", marks=pytest.mark.slow), "two roots"],
)
def case(request):
    kinds, parents = TREES[request.param]
    seed = list(TREES).index(request.param)
    tree, mj = random_tree(kinds, parents, seed)
    random = np.random.default_rng(100 + seed)
    q, v, given = (random.normal(size=(STATES, n)) for n in (mj.nq, mj.nv, mj.nv))
    q = np.asarray(jax.vmap(tree.normalised)(q))
    # The numbers of the first tree are known when it is compiled, those of the others are not.
    run = compiled(partial(dynamics, tree)) if seed == 0 else partial(compiled(dynamics), tree)
    return tree, mj, q, v, given, jax.tree.map(np.asarray, run(q, v, given))


def mujoco_at(tree, mj, q, v):
    """MuJoCo's data at one state, and where its speeds are."""
    coordinates, speeds = orders(tree, mj)
    data = mujoco.MjData(mj)
    data.qpos[coordinates], data.qvel[speeds] = q, v
    mujoco.mj_forward(mj, data)
    return data, speeds


def same(ours, theirs, tolerance=1e-12):
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * np.abs(theirs).max())


def test_the_mass_matrix_is_that_of_mujoco(case):
    tree, mj, q, v, _, ours = case
    for i in range(STATES):
        data, speeds = mujoco_at(tree, mj, q[i], v[i])
        full = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, full)
        same(ours["mass matrix"][i], full[np.ix_(speeds, speeds)])


def test_bias_inverse_and_forward_dynamics_are_those_of_mujoco(case):
    tree, mj, q, v, given, ours = case
    for i in range(STATES):
        data, speeds = mujoco_at(tree, mj, q[i], v[i])
        same(ours["bias"][i], (data.qfrc_bias - data.qfrc_passive)[speeds])
        data.qacc[speeds] = given[i]
        mujoco.mj_inverse(mj, data)
        same(ours["inverse"][i], data.qfrc_inverse[speeds])
        data.qfrc_applied[speeds] = given[i]
        mujoco.mj_forward(mj, data)
        same(ours["forward"][i], data.qacc[speeds])


def test_poses_points_and_their_velocities_are_those_of_mujoco(case):
    tree, mj, q, v, _, ours = case
    for i in range(STATES):
        data, _ = mujoco_at(tree, mj, q[i], v[i])
        for body in tree.given:
            index = mj.body(body.name).id
            rotation, position = data.xmat[index].reshape(3, 3), data.xpos[index]
            np.testing.assert_allclose(ours["poses"][body.name][0][i], rotation, rtol=0, atol=1e-12)
            np.testing.assert_allclose(ours["poses"][body.name][1][i], position, rtol=0, atol=1e-11)
            point = position + rotation @ [0.3, -0.2, 0.5]
            np.testing.assert_allclose(ours["points"][body.name][i], point, rtol=0, atol=1e-11)
            jacobian = np.zeros((3, mj.nv))
            mujoco.mj_jac(mj, data, jacobian, None, point, index)
            np.testing.assert_allclose(ours["velocities"][body.name][i], jacobian @ data.qvel, rtol=0, atol=1e-10)


def test_energies_are_those_of_mujoco(case):
    tree, mj, q, v, _, ours = case
    mj.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    for i in range(STATES):
        data, _ = mujoco_at(tree, mj, q[i], v[i])
        # What is fixed to the ground has a weight, but no coordinate: its constant is left out here.
        grounded = sum(
            9.81 * mj.body(index).mass[0] * data.xipos[index][2]
            for index in range(1, mj.nbody)
            if mj.body_weldid[index] == 0
        )
        same(np.array([ours["potential"][i], ours["kinetic"][i]]), data.energy - [grounded, 0.0])


def test_coordinates_change_along_the_velocity_as_in_mujoco(case):
    tree, mj, q, v, _, ours = case
    coordinates, speeds = orders(tree, mj)
    full = np.zeros(mj.nv)
    for i in range(STATES):
        full[speeds] = v[i]
        step = 1e-4
        ahead, behind = np.zeros(mj.nq), np.zeros(mj.nq)
        ahead[coordinates] = behind[coordinates] = q[i]
        mujoco.mj_integratePos(mj, ahead, full, step)
        mujoco.mj_integratePos(mj, behind, full, -step)
        rates = ((ahead - behind) / (2 * step))[coordinates]
        np.testing.assert_allclose(ours["map"][i] @ v[i], rates, rtol=0, atol=1e-7)


def test_the_mass_matrix_is_positive_definite_and_the_derivative_of_inverse_dynamics(case):
    tree, _, q, v, given, ours = case
    slopes = compiled(jax.vmap(jax.jacfwd(tree.inverse_dynamics, argnums=2)))(q, v, given)
    for matrix, slope in zip(ours["mass matrix"], slopes, strict=True):
        same(matrix, matrix.T, 1e-14)
        assert np.linalg.eigvalsh(matrix)[0] > 0
        same(matrix, np.asarray(slope), 1e-13)


def test_inverse_dynamics_undo_forward_dynamics(case):
    tree, _, q, v, given, ours = case
    force = compiled(jax.vmap(tree.inverse_dynamics))(q, v, ours["forward"])
    same(np.asarray(force), given, 1e-11)


@pytest.mark.slow
def test_forward_derivatives_are_those_of_central_differences():
    tree, mj = random_tree(["free", "revolute", "ball"], [-1, 0, 1], 7)
    random = np.random.default_rng(8)
    sizes = np.cumsum([mj.nq, mj.nv])
    point = jnp.asarray(random.normal(size=mj.nq + 2 * mj.nv))
    directions = jnp.asarray(random.normal(size=(4, point.size)))

    def both(point):
        q, v, given = jnp.split(point, sizes)
        return jnp.concatenate([tree.inverse_dynamics(q, v, given), tree.forward_dynamics(q, v, given)])

    exact = compiled(jax.vmap(lambda along: jax.jvp(both, (point,), (along,))[1]))(directions)
    step = 1e-5
    pairs = jnp.concatenate([point[None] + step * directions, point[None] - step * directions])
    ahead, behind = np.split(np.asarray(compiled(jax.vmap(both))(pairs)), 2)
    for derivative, difference in zip(np.asarray(exact), (ahead - behind) / (2 * step), strict=True):
        same(derivative, difference, 1e-7)
