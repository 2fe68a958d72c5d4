"""A robot from a file, with a payload of uncertain mass: its counterweight and its fastest motion, decided together.

The arm is a URDF, as CAD programs write it: two links with dampers in the joints, a counterweight behind the shoulder,
and a payload in the gripper. The torque limits are those of the file. They hold for all payloads, and the optimiser
chooses the mass of the counterweight: a heavy one carries the payload, but has to be moved as well.

    python examples/robot_from_file.py
"""

import tempfile
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

import aleator as al

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper_arm">
    <inertial><origin xyz="0.2 0 0"/><mass value="2.0"/>
      <inertia ixx="0.002" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm/upper_arm.dae"/></geometry></visual>
  </link>
  <link name="counterweight">
    <inertial><mass value="3.0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="forearm">
    <inertial><origin xyz="0.15 0 0"/><mass value="1.0"/>
      <inertia ixx="0.001" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="payload">
    <inertial><mass value="1.0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper_arm"/><origin xyz="0 0 0.5"/><axis xyz="0 -1 0"/>
    <limit lower="-1.5" upper="2.5" effort="20" velocity="5"/><dynamics damping="0.2"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper_arm"/><child link="forearm"/><origin xyz="0.4 0 0"/><axis xyz="0 -1 0"/>
    <limit lower="-2.5" upper="2.5" effort="10" velocity="5"/><dynamics damping="0.1"/>
  </joint>
  <joint name="rear" type="fixed">
    <parent link="upper_arm"/><child link="counterweight"/><origin xyz="-0.2 0 0"/>
  </joint>
  <joint name="gripper" type="fixed"><parent link="forearm"/><child link="payload"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "arm.urdf"
    file.write_text(URDF, encoding="utf-8")
    robot = al.foreign.read_urdf(file)

robot = eqx.tree_at(
    lambda robot: (robot.parts["payload"].mass, robot.parts["counterweight"].mass),
    robot,
    (al.Uniform(1.0, half_width=0.3), al.Decision(3.0, 0.5, 12.0)),
)
ends: dict[str, Any] = {"start": ((-0.5, 0.3), 0.0), "end": ((1.0, 0.8), 0.0)}
path = np.linspace(*(ends[end][0] for end in ("start", "end")), 40)
motion = al.BSpline(al.Decision(al.fit_control_points(path, 4, **ends), -1.5, 2.5), **ends)
problem = al.Problem(
    al.InverseDynamics(robot, motion=motion),
    grid=al.Grid(al.Decision(1.0, 0.2, 5.0), steps=28),
    minimize=al.objectives.final_time(),
    # Torques are affine in the payload: the square root of 3 standard deviations is the worst case.
    subject_to=[al.path(name).within(*allowed, sigmas=3**0.5) for name, allowed in robot.limits.items()],
    expansion=al.Expansion(order=1),
)

if __name__ == "__main__":
    print("\n".join(robot.notes))
    solution = al.solve(problem)
    print(solution)
    print(al.validate(solution, samples=2000))
