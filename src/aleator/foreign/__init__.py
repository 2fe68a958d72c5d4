"""Models that come from elsewhere: SymPy, FMUs, files of robots, black boxes; and our problems in OpenMDAO."""

from aleator.foreign._ask import Asked as Asked
from aleator.foreign._ask import ask as ask
from aleator.foreign._black_box import BlackBox as BlackBox
from aleator.foreign._command import Command as Command
from aleator.foreign._command import Isolated as Isolated
from aleator.foreign._fmu import Fmu as Fmu
from aleator.foreign._fmu import FmuSimulation as FmuSimulation
from aleator.foreign._fmu import FmuSystem as FmuSystem
from aleator.foreign._mjcf import read_mjcf as read_mjcf
from aleator.foreign._openmdao import openmdao_component as openmdao_component
from aleator.foreign._robot import Robot as Robot
from aleator.foreign._sympy_mechanics import from_kane as from_kane
from aleator.foreign._sympy_mechanics import from_lagrange as from_lagrange
from aleator.foreign._sympy_system import from_sympy as from_sympy
from aleator.foreign._sympy_system import from_sympy_formulas as from_sympy_formulas
from aleator.foreign._urdf import read_urdf as read_urdf
