"""Functional mock-up units (FMI 2 and 3), run by FMPy: read, simulated, differentiated.

`_description` reads the file, `_library` speaks to the compiled code, `_equations` and `_derivatives` differentiate,
`_runs` integrates or lets co-simulation step. All that happens behind a door (`_doors`): in a process of its own or in
this one. `_fmu`, `_simulation` and `_system` are what users see.
"""

from aleator.foreign._fmu._fmu import Fmu as Fmu
from aleator.foreign._fmu._simulation import FmuSimulation as FmuSimulation
from aleator.foreign._fmu._system import FmuSystem as FmuSystem
