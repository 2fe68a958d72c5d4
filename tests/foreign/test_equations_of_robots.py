"""Equations of MJCF, `connect`, `weld` and `joint`, against MuJoCo's Jacobians."""

import mujoco
import numpy as np
import pytest
from mujoco_robots import orders

import aleator as al
from compiling import compiled

SPACE = """<mujoco>
  <option gravity="1 2 -9.81"/>
  <worldbody>
    <body name="arm" pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="shoulder" axis="0 1 2"/><geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.05"/>
      <body name="hand" pos="0.5 0 0"><joint name="wrist" type="ball"/>
        <geom type="box" size="0.1 0.05 0.02" pos="0.1 0 0"/><site name="tip" pos="0.2 0 0" euler="0 40 0"/></body>
    </body>
    <body name="drone" pos="1 0.3 0.2" euler="0 0 50"><freejoint name="drone"/>
      <geom type="box" size="0.2 0.1 0.05" pos="0.05 0 0"/><site name="foot" pos="0 0 -0.1"/></body>
    <body name="cart" pos="0 1 0"><joint name="rail" type="slide" axis="1 0 1" ref="0.2"/>
      <geom size="0.1"/></body>
    <body name="wheel" pos="0 2 0"><joint name="axle" axis="0 1 0" ref="30"/><geom size="0.1" pos="0.1 0 0"/></body>
  </worldbody>
  <equality>{}</equality>
</mujoco>
"""
EQUATIONS = {
    "connect to the ground": '<connect name="pin" body1="drone" anchor="0.1 0.2 0.3"/>',
    "weld": '<weld body1="hand" body2="drone" anchor="0.1 0 0"/>',
    "weld somewhere else": '<weld name="bond" body1="drone" body2="hand" relpose="0.3 0 0 1 0.1 0.2 0.3"/>',
    "a joint that is held": '<joint joint1="rail" polycoef="0.1 0 0 0 0"/>',
    "several": '<connect body1="hand" body2="drone" anchor="0 0 0"/><joint joint1="axle" joint2="rail"/>'
    '<weld name="off" body1="drone" active="false"/>',
}


def written(folder, text):
    (folder / "robot.xml").write_text(text)
    return folder / "robot.xml"


def by_mujoco(path, robot, q):
    """Jacobian of the equations in the order of aleator's names, and what is left of them."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    coordinates, speeds = orders(model, robot)
    data = mujoco.MjData(model)
    data.qpos[coordinates] = q
    mujoco.mj_forward(model, data)
    equations = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return data.efc_J.reshape(-1, model.nv)[equations][:, speeds], data.efc_pos[equations]


def satisfying(robot):
    """A posture that satisfies the equations, by Gauss and Newton's steps from a random one near the reference."""
    random = np.random.default_rng(3)
    rest = np.array([robot.start.get(name, 0.0) for name in robot.coordinates])
    q = rest + 0.1 * random.normal(size=len(rest))

    @compiled
    def step(q):
        q = robot.normalised(q)
        return q, robot.closing(q), robot.closing_jacobian(q), robot.velocity_map(q)

    for _ in range(20):
        q, apart, jacobian, rates = map(np.asarray, step(q))
        q = q - rates @ np.linalg.lstsq(jacobian, apart)[0]
    q, apart, *_ = map(np.asarray, step(q))
    assert np.max(np.abs(apart)) < 1e-13
    return q


def projector(jacobian):
    """On the speeds that equations forbid, however they are scaled and combined."""
    return np.linalg.pinv(jacobian) @ jacobian


FEW = ("several",)  # of them, the others are slow


@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in EQUATIONS]
)
def test_equations_forbid_the_speeds_that_those_of_mujoco_forbid(name, tmp_path):
    path = written(tmp_path, SPACE.format(EQUATIONS[name]))
    robot = al.foreign.read_mjcf(path)
    q = satisfying(robot)
    jacobian, apart = by_mujoco(path, robot, q)
    assert np.abs(apart).max() < 1e-12
    ours = np.asarray(compiled(robot.closing_jacobian)(q))
    np.testing.assert_allclose(projector(ours), projector(jacobian), rtol=0, atol=1e-9)
    assert ours.shape == jacobian.shape == (len(robot.constraints), len(robot.speeds))


# Hinges whose axes are parallel: the links move in one plane, on which none of them need lie.
PLANE = """<mujoco>
  <worldbody>
    <body name="frame" euler="{euler}">
      <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/>
        <body name="rod" pos="0 0 0.2"><joint name="rod" axis="0 -1 0"/>
          <geom type="capsule" fromto="0 0 0 0.5 0 0.1" size="0.02"/><site name="end" pos="0.5 0.1 0.1"/></body></body>
      <body name="rocker" pos="0.5 0 0"><joint name="rocker" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02"/><site name="top" pos="0 0.1 0.3"/></body>
    </body>
  </worldbody>
  <equality><connect name="pin" site1="end" site2="top"/></equality>
</mujoco>
"""


@pytest.mark.slow
@pytest.mark.parametrize("euler", ["0 0 0", "20 30 40"])
def test_a_loop_of_hinges_in_one_plane_is_closed_in_this_plane(euler, tmp_path):
    path = written(tmp_path, PLANE.format(euler=euler))
    robot = al.foreign.read_mjcf(path)
    q = satisfying(robot)
    jacobian, apart = by_mujoco(path, robot, q)
    assert np.abs(apart).max() < 1e-12
    ours = np.asarray(compiled(robot.closing_jacobian)(q))
    assert len(ours) == 2, "across the plane nothing is said, which would leave a force undetermined"
    np.testing.assert_allclose(projector(ours), projector(jacobian), rtol=0, atol=1e-9)
