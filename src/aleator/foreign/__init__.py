"""Models that other tools deliver, as functions and systems of this package: FMUs (`Fmu`, extra `fmu`)."""

from aleator.foreign._fmu import Fmu as Fmu
from aleator.foreign._fmu import FmuSimulation as FmuSimulation
from aleator.foreign._fmu import FmuSystem as FmuSystem
