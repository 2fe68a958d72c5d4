"""Functional mock-up units (FMI 2 and 3), run by FMPy: read, simulated, differentiated.

`_files` reads and unpacks, `_variables` says what may be set and read, `_library` and `_instance` speak to the library,
`_exchange` integrates model exchange and `_cosimulation` lets co-simulation step; `_sensitivities` and `_differences`
differentiate. All that happens behind a door (`_doors`): in a process of its own (`_own_process`, `_worker`) or in
this one. `_callbacks` makes functions of JAX of what is asked there. `_fmu`, `_simulation` and `_system` are what users
see.
"""

from aleator.foreign._fmu._fmu import Fmu as Fmu
from aleator.foreign._fmu._simulation import FmuSimulation as FmuSimulation
from aleator.foreign._fmu._system import FmuSystem as FmuSystem
