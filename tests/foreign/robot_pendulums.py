"""The pendulum on which every foreign format is checked: a uniform rod of 1 kg and 1 m, hinged at its end, with viscous
damping of 0.1 N·m·s/rad, under gravity of 9.81 m/s². The hinge is about y; at zero the rod hangs.
"""

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
