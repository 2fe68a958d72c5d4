"""What is loaded at its first use; see `__init__.py`."""

from ._ask import Asked as Asked
from ._ask import ask as ask
from ._black_box import BlackBox as BlackBox
from ._command import Command as Command
from ._command import Isolated as Isolated
from ._fmu._fmu import Fmu as Fmu
from ._fmu._functions import FmuSimulation as FmuSimulation
from ._fmu._functions import FmuSystem as FmuSystem
from ._mjcf import read_mjcf as read_mjcf
from ._openmdao import openmdao_component as openmdao_component
from ._robot import Robot as Robot
from ._robot import read_urdf as read_urdf
from ._sympy_systems import from_kane as from_kane
from ._sympy_systems import from_lagrange as from_lagrange
from ._sympy_systems import from_sympy as from_sympy
from ._sympy_systems import from_sympy_formulas as from_sympy_formulas
