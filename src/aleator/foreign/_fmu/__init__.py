"""Functional mock-up units (FMI 2 and 3): read and loaded by FMPy, simulated, differentiated.

`_description` says what a file offers; `_instance` calls the compiled code, `_motion` simulates it, and `_library` is
what can be asked of it, behind a door (`_doors`): in a process of its own or in this one. `_differences` makes its
answers functions of JAX. `_fmu`, `_simulation` and `_system` are what users see.
"""

from aleator.foreign._fmu._fmu import Fmu as Fmu
from aleator.foreign._fmu._simulation import FmuSimulation as FmuSimulation
from aleator.foreign._fmu._system import FmuSystem as FmuSystem
