"""Files that are broken, or describe what a tree has no place for, end in a sentence with the file and the element."""

import pytest

import aleator as al

# A pendulum in either format: a uniform rod of 1 kg and 1 m with viscous damping, hinged at its end.
URDF = """<?xml version="1.0"?>
<robot name="pendulum">
  <link name="ground"/>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5"/>
      <mass value="1.0"/>
      <inertia ixx="0.08333333333333333" iyy="0.08333333333333333" izz="0" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><mesh filename="package://nowhere/rod.dae"/></geometry></visual>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="ground"/>
    <child link="rod"/>
    <axis xyz="0 1 0"/>
    <dynamics damping="0.1"/>
  </joint>
</robot>
"""

MJCF = """<mujoco>
  <asset><mesh name="rod" file="nowhere.stl"/></asset>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <inertial pos="0 0 -0.5" mass="1.0" diaginertia="0.08333333333333333 0.08333333333333333 1e-12"/>
      <geom type="mesh" mesh="rod"/>
    </body>
  </worldbody>
</mujoco>
"""

ROD = '<mass value="1.0"/>'
AXIS = '<axis xyz="0 1 0"/>'
SECOND = '<link name="tip"/><joint name="bolt" type="fixed"><parent link="{}"/><child link="tip"/></joint></robot>'
TWICE = URDF.replace("</robot>", SECOND.format("ground")).replace(
    "</robot>", '<joint name="screw" type="fixed"><parent link="rod"/><child link="tip"/></joint></robot>'
)

BROKEN_URDF = {
    "two roots": (URDF.replace("</robot>", '<link name="stool"/></robot>'), ["['ground', 'stool']", "type fixed"]),
    "a link that two joints carry": (TWICE, ["link 'tip'", "'bolt' and 'screw'", "al.joints.Closure"]),
    "a negative mass": (URDF.replace(ROD, '<mass value="-1"/>'), ["link 'rod'", "received -1"]),
    "an attribute that is misspelt": (URDF.replace("<mass value", "<mass walue"), ["<mass>", "'walue'"]),
    "dry friction": (URDF.replace('damping="0.1"', 'friction="0.1"'), ["joint 'hinge'", "('friction',)"]),
    "a joint that follows": (URDF.replace(AXIS, '<mimic joint="a"/>'), ["joint 'hinge'", "('mimic',)"]),
}


def refusal(folder, read, text, **options):
    (folder / "robot.xml").write_text(text)
    with pytest.raises(al.ProblemError) as caught:
        read(folder / "robot.xml", **options)
    message = str(caught.value)
    assert "robot.xml" in message
    assert message.endswith(".")
    return message


def mjcf(body="", after=""):
    joint = '<joint name="hinge" axis="0 1 0"/><inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>'
    return f'<mujoco><worldbody><body name="rod">{body or joint}</body></worldbody>{after}</mujoco>'


HINGE = '<joint name="hinge" {}/><inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>'
BALL = '<joint name="hinge" type="ball" {}/><inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>'
BROKEN_MJCF = {
    "inertia from a mesh": (
        MJCF.replace("<inertial", "<!--").replace('1e-12"/>', "-->"),
        ["body 'rod'", "a mesh ('rod')", "<inertial>", "mj_saveLastXML"],
    ),
    "dry friction": (mjcf(HINGE.format('frictionloss="1"')), ["joint 'hinge'", "('friction',)"]),
    "a tendon with a spring": (
        mjcf(after='<tendon><fixed name="rope" stiffness="3"><joint joint="hinge" coef="1"/></fixed></tendon>'),
        ["tendon 'rope'", "('tendons',)"],
    ),
    "a damped ball": (mjcf(BALL.format('damping="1"')), ["joint 'hinge'", "('ball',)"]),
    "a rotor of an actuator": (
        mjcf(after='<actuator><motor name="motor" joint="hinge" armature="2"/></actuator>'),
        ["actuator 'motor'", "('actuators',)"],
    ),
    "no weight": (mjcf().replace('"rod"', '"rod" gravcomp="1"'), ["body 'rod'", "('gravcomp',)"]),
    "a stiffening spring": (mjcf(HINGE.format('stiffness="1 2"')), ["joint 'hinge'", "('polynomials',)"]),
    "a fluid": (mjcf(after='<option viscosity="1"/>'), ["option", "forces of a fluid", "('fluid',)"]),
}


BROKEN = [
    *(pytest.param(al.foreign.read_urdf, *case, id=f"URDF: {name}") for name, case in BROKEN_URDF.items()),
    *(pytest.param(al.foreign.read_mjcf, *case, id=f"MJCF: {name}") for name, case in BROKEN_MJCF.items()),
]


@pytest.mark.parametrize(("read", "text", "words"), BROKEN)
def test_a_broken_file_is_refused_by_its_element_and_an_effect_may_be_left_out_by_name(read, text, words, tmp_path):
    message = refusal(tmp_path, read, text)
    assert all(word in message for word in words), message
    if words[-1].endswith("',)"):
        effect = words[-1].strip("(),'")
        robot = read(tmp_path / "robot.xml", leave_out=[effect])
        assert robot.notes[0].startswith(f"Left out, as asked: {effect} ({words[0]}")


def test_effects_that_a_file_switches_off_are_no_effects(tmp_path):
    flags = '<option><flag frictionloss="disable" gravity="disable" spring="disable"/></option>'
    text = mjcf(HINGE.format('frictionloss="1" stiffness="2"'), after=flags)
    (tmp_path / "robot.xml").write_text(text)
    robot = al.foreign.read_mjcf(tmp_path / "robot.xml")
    assert robot.gravity == (0.0, 0.0, 0.0)
    assert robot.parts["hinge"].joint.stiffness == 0
