"""Recursions over random trees of bodies against MuJoCo's C library: one program for all numbers of a tree."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco_trees import Tree, orders, random_tree

import aleator as al
from compiling import compiled
from zoo import cases

# Every kind of joint, on branches, on a free base, and on a body that the ground holds; -1 is the ground.
KINDS = ["revolute", "prismatic", "ball", "fixed", "free", "fixed", "revolute"]
PARENTS = [-1, 0, 0, 1, -1, -1, 5]
STATES, AT, FEW = 2, (0.3, -0.2, 0.5), ("b3", "b4", "b6")


class Pushed(Tree):
    """With a force and a moment at the centre of mass of each body."""

    pushes: dict

    def body_loads(self, q, v):
        return tuple(
            al.BodyLoad(one.name, force=self.pushes[one.name][:3], moment=self.pushes[one.name][3:], at=one.center)
            for one in self.given
        )


@compiled
def dynamics(tree, q, v, given):
    """All that MuJoCo is asked for, at some states; `given` is an acceleration, or a force."""

    def at(q, v, given):
        return {
            "mass matrix": tree.mass_matrix(q),
            "bias": tree.bias(q, v),
            "inverse": tree.inverse_dynamics(q, v, given),
            "forward": tree.forward_dynamics(q, v, given),
            "pushes": tree.external(q, v),
            "poses": {name: tuple(pose) for name, pose in tree.poses(q).items()},
            "points": {name: tree.point(q, name, AT) for name in FEW},
            "velocities": {name: tree.point_velocity(q, v, name, AT) for name in FEW},
            "map": tree.velocity_map(q),
            "changes": changes(tree, q, v, given)(0.0),
            "energies": jnp.stack([tree.potential_energy(q), tree.kinetic_energy(q, v)]),
        }

    return jax.vmap(at)(*(jnp.asarray(one) for one in (q, v, given)))


def changes(tree, q, v, given):
    """How forces and accelerations change along the motion, where speeds and `given` change by fixed numbers."""

    def along(system, s):
        def at(s):
            return system(q + s * (tree.velocity_map(q) @ v), v + s * given, given + s * v)

        return jax.jvp(at, (s,), (1.0,))[1]

    return lambda s: [along(system, s) for system in (tree.inverse_dynamics, tree.forward_dynamics)]


@compiled
def curvatures(tree, q, v, given):
    """How the changes change."""
    return jax.vmap(lambda *at: jax.jvp(changes(tree, *at), (0.0,), (1.0,))[1])(
        *(jnp.asarray(one) for one in (q, v, given))
    )


@cache
def case():
    tree, mj = random_tree(KINDS, PARENTS, 0)
    random = np.random.default_rng(100)
    q, v, given = (random.normal(size=(STATES, n)) for n in (mj.nq, mj.nv, mj.nv))
    q = np.stack([_normalised(tree, one) for one in q])
    pushed = Pushed(tree.given, {body.name: random.normal(size=6) for body in tree.given})
    found = jax.tree.map(np.asarray, dynamics(pushed, q, v, given))
    return [(pushed, mj, q[i], v[i], given[i], jax.tree.map(lambda x, i=i: x[i], found)) for i in range(STATES)]


def _normalised(tree, q):
    """With quaternions of length one, in place."""
    for start in [tree.coordinates.index(name) for name in tree.coordinates if name.endswith(("_w", "_qw"))]:
        q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    return q


def mujoco_at(tree, mj, q, v, pushes=None):
    """MuJoCo's data at one state, and where its speeds are."""
    coordinates, speeds = orders(tree, mj)
    mj.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(mj)
    data.qpos[coordinates], data.qvel[speeds] = q, v
    for name, push in (pushes or {}).items():
        data.xfrc_applied[mj.body(name).id] = push
    mujoco.mj_forward(mj, data)
    return data, speeds


def same(ours, theirs, tolerance=1e-12):
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * np.abs(theirs).max())


def test_mass_matrix_bias_and_both_dynamics_are_those_of_mujoco():
    for tree, mj, q, v, given, ours in case():
        data, speeds = mujoco_at(tree, mj, q, v)
        full = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, full)
        matrix = full[np.ix_(speeds, speeds)]
        same(ours["mass matrix"], matrix)
        same(ours["mass matrix"], ours["mass matrix"].T, 1e-14)
        same(ours["bias"], (data.qfrc_bias - data.qfrc_passive)[speeds])
        data.qacc[speeds] = given
        mujoco.mj_inverse(mj, data)
        same(ours["inverse"], data.qfrc_inverse[speeds])
        data.qfrc_applied[speeds] = given
        mujoco.mj_forward(mj, data)
        same(ours["forward"], data.qacc[speeds], 1e-10)


def test_forces_and_moments_on_bodies_accelerate_as_in_mujoco():
    for tree, mj, q, v, _, ours in case():
        data, speeds = mujoco_at(tree, mj, q, v, tree.pushes)
        same(np.linalg.solve(ours["mass matrix"], ours["pushes"] - ours["bias"]), data.qacc[speeds], 1e-9)


def test_poses_points_velocities_and_energies_are_those_of_mujoco():
    for tree, mj, q, v, _, ours in case():
        data, speeds = mujoco_at(tree, mj, q, v)
        for body in tree.given:
            index = mj.body(body.name).id
            rotation, position = data.xmat[index].reshape(3, 3), data.xpos[index]
            np.testing.assert_allclose(ours["poses"][body.name][0], rotation, rtol=0, atol=1e-12)
            np.testing.assert_allclose(ours["poses"][body.name][1], position, rtol=0, atol=1e-11)
            if body.name not in FEW:
                continue
            point = position + rotation @ AT
            np.testing.assert_allclose(ours["points"][body.name], point, rtol=0, atol=1e-11)
            jacobian = np.zeros((3, mj.nv))
            mujoco.mj_jac(mj, data, jacobian, None, point, index)
            np.testing.assert_allclose(ours["velocities"][body.name], jacobian @ data.qvel, rtol=0, atol=1e-10)
        # What is fixed to the ground has a weight, but no coordinate: its constant is left out here.
        held = [index for index in range(1, mj.nbody) if mj.body_weldid[index] == 0]
        grounded = sum(9.81 * mj.body(index).mass[0] * data.xipos[index][2] for index in held)
        same(ours["energies"], data.energy - [grounded, 0.0])
        # Coordinates change along the velocity.
        full, step = np.zeros(mj.nv), 1e-4
        full[speeds] = v
        ahead, behind = data.qpos.copy(), data.qpos.copy()
        mujoco.mj_integratePos(mj, ahead, full, step)
        mujoco.mj_integratePos(mj, behind, full, -step)
        rates = ((ahead - behind) / (2 * step))[orders(tree, mj)[0]]
        np.testing.assert_allclose(ours["map"] @ v, rates, rtol=0, atol=1e-7)


@pytest.mark.parametrize("order", cases([1, 2]))
def test_closed_derivatives_of_both_dynamics_are_differences_of_mujoco_s(order):
    # By coordinates, quaternions among them, by speeds, and by accelerations or forces.
    for tree, mj, q, v, given, ours in case():
        speeds = orders(tree, mj)[1]
        rates = ours["map"] @ v

        def by_mujoco(s, forward, tree=tree, mj=mj, q=q, v=v, given=given, rates=rates, speeds=speeds):
            data, _ = mujoco_at(tree, mj, q + s * rates, v + s * given)
            if forward:
                data.qfrc_applied[speeds] = given + s * v
                mujoco.mj_forward(mj, data)
                return data.qacc[speeds]
            data.qacc[speeds] = given + s * v
            mujoco.mj_inverse(mj, data)
            return data.qfrc_inverse[speeds]

        found = ours["changes"] if order == 1 else [one[0] for one in curvatures(tree, q[None], v[None], given[None])]
        for forward, change in enumerate(found):
            # Differences of fourth order.
            h = 2e-3
            values = {k: by_mujoco(k * h, forward) for k in range(-2, 3)}
            if order == 1:
                same(change, (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * h), 1e-7)
            else:
                bent = 16 * (values[1] + values[-1]) - (values[2] + values[-2]) - 30 * values[0]
                same(change, bent / (12 * h**2), 1e-5)
