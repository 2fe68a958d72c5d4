"""Dynamical systems and their simulation. Knows no randomness."""

from aleator.dynamics._grid import Grid as Grid
from aleator.dynamics._integrators import AbstractIntegrator as AbstractIntegrator
from aleator.dynamics._integrators import History as History
from aleator.dynamics._integrators import Inputs as Inputs
from aleator.dynamics._integrators import Kvaerno5 as Kvaerno5
from aleator.dynamics._integrators import RungeKutta4 as RungeKutta4
from aleator.dynamics._integrators import Tsit5 as Tsit5
from aleator.dynamics._integrators import simulate as simulate
from aleator.dynamics._signal import AbstractSignal as AbstractSignal
from aleator.dynamics._signal import Tabulated as Tabulated
from aleator.dynamics._system import System as System
from aleator.dynamics._system import input_names as input_names
