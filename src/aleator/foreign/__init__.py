"""Robots that are read from files of other programs: URDF and MJCF."""

from aleator.foreign._mjcf import read_mjcf as read_mjcf
from aleator.foreign._robot import Robot as Robot
from aleator.foreign._urdf import read_urdf as read_urdf
