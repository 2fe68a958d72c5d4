"""What files say about joints and frames, on small robots that have all of it, against MuJoCo."""

import jax
import mujoco
import numpy as np
import pytest
from mujoco_robots import assert_same, by_aleator, by_mujoco, file_of, states, urdf_by_mujoco

import aleator as al

EVERYTHING = """<mujoco>
  <compiler angle="degree"/>
  <option gravity="0.5 0 -3"/>
  <default><geom material="wood"/><joint damping="0.3"/>
    <default class="stiff"><joint stiffness="2" springref="20"/></default></default>
  <asset><texture name="wood" type="2d" file="nowhere.png"/><material name="wood" texture="wood"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1" material="wood"/>
    <frame pos="0.3 0 0.2" euler="30 0 40">
      <body name="cart" pos="0.1 0.2 0.3" euler="10 20 30">
        <joint name="along" type="slide" axis="1 1 0" ref="0.4" armature="0.7"/>
        <joint name="about" axis="0 1 2" pos="0.1 -0.2 0.3" ref="25" armature="0.2" class="stiff" range="-90 45"/>
        <joint axis="1 0 0" pos="0 0.1 0"/>
        <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0" euler="0 30 0"/>
        <body name="plate" pos="0 0 0.4" quat="1 1 0 0"><geom type="cylinder" size="0.1 0.02"/>
          <body pos="0.2 0 0">
            <joint axis="0 0 1" damping="0"/>
            <inertial pos="0.1 0 0" mass="2" fullinertia="0.2 0.3 0.4 0.01 0.02 0.03"/>
          </body>
        </body>
      </body>
    </frame>
    <body name="ball" pos="0 0 1"><joint name="socket" type="ball" damping="0"/><geom size="0.1" pos="0.3 0 0"/></body>
    <body name="drone" pos="1 2 3" euler="0 0 90"><freejoint/>
      <geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.1"/></body>
  </worldbody>
  <actuator><motor joint="about"/></actuator>
  <sensor><jointpos joint="about"/></sensor>
</mujoco>
"""

ARM = """<robot name="arm">
  <link name="base"><inertial><mass value="3"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/><mass value="2"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>
  <link name="plate"><inertial><origin rpy="1 2 3"/><mass value="0.5"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="slider"><inertial><mass value="0.7"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="down" type="prismatic"><parent link="plate"/><child link="slider"/><origin xyz="0 0 0.3" rpy="0.5 0 0"/>
    <axis xyz="0 1 1"/><limit lower="-0.1" upper="0.2" effort="30" velocity="2"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><axis xyz="1 2 3"/><dynamics damping="0.4"/>
    <limit lower="-1" upper="2" effort="30" velocity="2"/></joint>
  <joint name="bolt" type="fixed"><parent link="upper"/><child link="plate"/><origin xyz="0 0 1" rpy="0 0 1"/></joint>
</robot>
"""


def written(folder, text, name="robot.xml"):
    (folder / name).write_text(text)
    return folder / name


def test_springs_references_anchors_and_all_kinds_of_joints_are_those_of_mujoco(tmp_path):
    robot = al.foreign.read_mjcf(written(tmp_path, EVERYTHING))
    plain = EVERYTHING.replace(' file="nowhere.png"', ' builtin="flat" width="1" height="1"')
    at = states(robot, 3, seed=1)
    assert_same(by_aleator(robot, *at), by_mujoco(mujoco.MjModel.from_xml_string(plain), robot, *at))
    moving = ("along", "about", "cart_joint", "body_3")
    assert robot.coordinates[:4] == moving
    assert robot.start == pytest.approx(
        {"along": 0.4, "about": np.deg2rad(25), "socket_w": 1.0}
        | {f"drone_{end}": value for end, value in zip("xyz", (1.0, 2.0, 3.0), strict=True)}
        | {"drone_qw": np.sqrt(0.5), "drone_qz": np.sqrt(0.5)}
    )
    assert robot.limits["about"] == pytest.approx((-np.pi / 2, np.pi / 4))


@pytest.mark.slow
def test_frames_and_turned_inertia_of_a_urdf_are_those_of_mujoco(tmp_path):
    robot = al.foreign.read_urdf(written(tmp_path, ARM), floating=True)
    model = mujoco.MjModel.from_xml_string(_on_a_free_base(urdf_by_mujoco(ARM), tmp_path))
    at = states(robot, 3, seed=2)
    # MuJoCo writes numbers with few digits.
    assert_same(by_aleator(robot, *at), by_mujoco(model, robot, *at), 1e-5)


def _on_a_free_base(model, folder):
    """The same arm where its base, which is fixed in MuJoCo, moves freely."""
    mujoco.mj_saveLastXML(str(folder / "saved.xml"), model)
    head, rest = (folder / "saved.xml").read_text().split("<worldbody>")
    arm, tail = rest.split("</worldbody>")
    base = '<body name="base"><freejoint/><inertial pos="0 0 0" mass="3" diaginertia="0.2 0.3 0.4"/>'
    return f"{head}<worldbody>{base}{arm}</body></worldbody>{tail}"


def test_limits_have_the_names_of_outputs(tmp_path):
    robot = al.foreign.read_urdf(written(tmp_path, ARM))
    same = jax.tree.map(lambda leaf: leaf, robot)
    assert [body.name for body in same.bodies()] == [body.name for body in robot.bodies()]
    assert robot.limits == {
        "shoulder": (-1.0, 2.0),
        "shoulder_rate": (-2.0, 2.0),
        "shoulder_torque": (-30.0, 30.0),
        "down": (-0.1, 0.2),
        "down_rate": (-2.0, 2.0),
        "down_torque": (-30.0, 30.0),
    }
    assert {"down", "down_rate"} <= set(robot.coordinates) | set(robot.speeds)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "path", "left_out"),
    [
        ("airo_models", "arms/ur5e/ur5e.urdf", ()),
        ("airo_models", "grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf", ("mimic",)),
        ("gymnasium", "envs/mujoco/assets/humanoid.xml", ()),
    ],
)
def test_mass_matrix_bias_and_gravity_of_public_robots_are_those_of_mujoco(package, path, left_out):
    file = file_of(package, path)
    if file.suffix == ".urdf":
        robot, model = al.foreign.read_urdf(file, leave_out=left_out), urdf_by_mujoco(file.read_text())
    else:
        robot, model = al.foreign.read_mjcf(file, leave_out=left_out), mujoco.MjModel.from_xml_path(str(file))
    at = states(robot, 3, seed=7)
    assert_same(by_aleator(robot, *at), by_mujoco(model, robot, *at))
