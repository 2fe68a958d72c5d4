"""Models of other libraries as systems of our own, and our problems in theirs: `al.foreign.from_sympy(...)`."""

from aleator.foreign._openmdao import openmdao_component as openmdao_component
from aleator.foreign._sympy_formulas import from_sympy_formulas as from_sympy_formulas
from aleator.foreign._sympy_mechanics import from_kane as from_kane
from aleator.foreign._sympy_mechanics import from_lagrange as from_lagrange
from aleator.foreign._sympy_system import from_sympy as from_sympy
"""Models that live elsewhere: black boxes, command lines, and points to be answered by whoever has the model."""

from aleator.foreign._ask import Asked as Asked
from aleator.foreign._ask import ask as ask
from aleator.foreign._black_box import BlackBox as BlackBox
from aleator.foreign._command import Command as Command
from aleator.foreign._isolated import Isolated as Isolated
