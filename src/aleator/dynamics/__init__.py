"""Dynamical and algebraic systems and their simulation. Knows no randomness."""

from aleator.dynamics._algebraic import AlgebraicSystem as AlgebraicSystem
from aleator.dynamics._algebraic import Solved as Solved
from aleator.dynamics._algebraic import explain_failure as explain_failure
from aleator.dynamics._algebraic import solve_algebraic as solve_algebraic
from aleator.dynamics._assembly import Assembly as Assembly
from aleator.dynamics._grid import AbstractGrid as AbstractGrid
from aleator.dynamics._grid import Grid as Grid
from aleator.dynamics._grid import Instant as Instant
from aleator.dynamics._instantaneous import Known as Known
from aleator.dynamics._instantaneous import known_at as known_at
from aleator.dynamics._instantaneous import observed_at as observed_at
from aleator.dynamics._integrators import AbstractIntegrator as AbstractIntegrator
from aleator.dynamics._integrators import History as History
from aleator.dynamics._integrators import Inputs as Inputs
from aleator.dynamics._integrators import Kvaerno5 as Kvaerno5
from aleator.dynamics._integrators import RungeKutta4 as RungeKutta4
from aleator.dynamics._integrators import Tsit5 as Tsit5
from aleator.dynamics._refusals import check_signals as check_signals
from aleator.dynamics._simulate import simulate as simulate
from aleator.dynamics._system import System as System
from aleator.dynamics._system import called as called
from aleator.dynamics._system import check_inputs as check_inputs
from aleator.dynamics._system import input_names as input_names
from aleator.dynamics._system import observation as observation
