"""The nonlinear program and its solvers. Knows no physics."""

from ._filtersqp import FilterSQP as FilterSQP
from ._filtersqp import default_solver as default_solver
from ._ipopt import Ipopt as Ipopt
from ._outcome import Outcome as Outcome
from ._outcome import Status as Status
from ._program import Evaluation as Evaluation
from ._program import NonlinearProgram as NonlinearProgram
from ._slsqp import Slsqp as Slsqp
from ._solver import AbstractSolver as AbstractSolver
