"""Files that are broken, or describe what a tree has no place for, end in a sentence with the file and the element."""

import pytest
from robot_pendulums import MJCF, URDF

import aleator as al

ROD = '<mass value="1.0"/>'
AXIS = '<axis xyz="0 1 0"/>'
SECOND = '<link name="tip"/><joint name="bolt" type="fixed"><parent link="{}"/><child link="tip"/></joint></robot>'
RING = """<robot name="ring"><link name="a"/><link name="b"/>
  <joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>
  <joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint></robot>"""
TWICE = URDF.replace("</robot>", SECOND.format("ground")).replace(
    "</robot>", '<joint name="screw" type="fixed"><parent link="rod"/><child link="tip"/></joint></robot>'
)

BROKEN_URDF = {
    "no XML": ("<robot><link>", ["expected XML", "line 1"]),
    "a cycle beside the root": (
        URDF.replace("</robot>", RING[RING.index("<link") :]),
        ["a cycle: ['a', 'b']"],
    ),
    "two roots": (URDF.replace("</robot>", '<link name="stool"/></robot>'), ["['ground', 'stool']", "type fixed"]),
    "a link that two joints carry": (TWICE, ["link 'tip'", "'bolt' and 'screw'", "al.joints.Closure"]),
    "a name twice": (URDF.replace("</robot>", '<link name="rod"/></robot>'), ["link 'rod'", "received two"]),
    "a negative mass": (URDF.replace(ROD, '<mass value="-1"/>'), ["link 'rod'", "received -1"]),
    "a mass of digits apart": (URDF.replace(ROD, '<mass value="1_0"/>'), ["link 'rod'", "'1_0'"]),
    "an attribute that is misspelt": (URDF.replace("<mass value", "<mass walue"), ["<mass>", "'walue'"]),
    "an origin that is misspelt": (URDF.replace("<origin xyz", "<origin xyyz"), ["<origin>", "'xyyz'"]),
    "limits in the wrong order": (
        URDF.replace('"continuous"', '"revolute"').replace(AXIS, f'{AXIS}<limit lower="1" upper="-1"/>'),
        ["<limit>", "a lower limit below the upper"],
    ),
    "an inertia without all its numbers": (URDF.replace('ixy="0"', ""), ["<inertia>", "attribute ixy"]),
    "an impossible inertia": (URDF.replace('izz="0"', 'izz="9"'), ["link 'rod'", "principal moment (9)"]),
    "a joint that moves nothing": (
        URDF.replace("<inertial>", "<x>").replace("</inertial>", "</x>"),
        ["moves some mass"],
    ),
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
    body = body if "<joint" in body or "<freejoint" in body else joint + body
    return f'<mujoco><worldbody><body name="rod">{body}</body></worldbody>{after}</mujoco>'


HINGE = '<joint name="hinge" {}/><inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>'
BALL = '<joint name="hinge" type="ball" {}/><inertial pos="0 0 -0.5" mass="1" diaginertia="1 1 1"/>'
BROKEN_MJCF = {
    "no XML": ("<mujoco><body>", ["expected XML", "line 1"]),
    "a negative mass": (MJCF.replace('mass="1.0"', 'mass="-1"'), ["MuJoCo", "rod"]),
    "a place that is no number": (
        mjcf('<joint/><geom name="ball" size="1" pos="nan 0 0"/>'),
        ["geom 'ball'", "expected numbers as"],
    ),
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


def test_a_file_with_several_effects_is_told_all_that_it_takes_to_read_it(tmp_path):
    text = URDF.replace('damping="0.1"', 'friction="0.1"').replace(AXIS, '<mimic joint="a"/>')
    assert "leave_out=('mimic', 'friction')" in refusal(tmp_path, al.foreign.read_urdf, text)


def test_effects_that_a_file_switches_off_are_no_effects(tmp_path):
    flags = '<option><flag frictionloss="disable" gravity="disable" spring="disable"/></option>'
    text = mjcf(HINGE.format('frictionloss="1" stiffness="2"'), after=flags)
    (tmp_path / "robot.xml").write_text(text)
    robot = al.foreign.read_mjcf(tmp_path / "robot.xml")
    assert robot.gravity == (0.0, 0.0, 0.0)
    assert robot.parts["hinge"].joint.stiffness == 0


def test_what_a_file_has_beside_bodies_is_noted(tmp_path):
    text = MJCF.replace("</mujoco>", '<actuator><motor joint="hinge"/></actuator></mujoco>')
    text = text.replace("<geom", '<geom size="0.1"/><geom').replace('axis="0 1 0"', 'axis="0 1 0" range="-90 90"')
    (tmp_path / "robot.xml").write_text(text)
    notes = " ".join(al.foreign.read_mjcf(tmp_path / "robot.xml").notes)
    for words in ("Meshes", "nothing enforces them", "Actuators are not read (1)", "no contact"):
        assert words in notes
    (tmp_path / "robot.xml").write_text(
        URDF.replace("</robot>", "<gazebo/></robot>").replace("<visual>", "<stiffness/><visual>")
    )
    notes = " ".join(al.foreign.read_urdf(tmp_path / "robot.xml").notes)
    for words in ("have no mass: ground", "in <robot>: <gazebo>", "in <link>: <stiffness>"):
        assert words in notes
