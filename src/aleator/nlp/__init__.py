"""The nonlinear program and its solvers, independent of any physics."""

from aleator.nlp._condensing import Condensing as Condensing
from aleator.nlp._elsewhere import feasible_elsewhere as feasible_elsewhere
from aleator.nlp._elsewhere import variable_range as variable_range
from aleator.nlp._filtersqp import FilterSQP as FilterSQP
from aleator.nlp._filtersqp import default_solver as default_solver
from aleator.nlp._interior_point import InteriorPoint as InteriorPoint
from aleator.nlp._ipopt import Ipopt as Ipopt
from aleator.nlp._matrices import Matrix as Matrix
from aleator.nlp._matrices import SparseMatrix as SparseMatrix
from aleator.nlp._matrices import with_entries as with_entries
from aleator.nlp._outcome import Outcome as Outcome
from aleator.nlp._outcome import Status as Status
from aleator.nlp._program import Evaluation as Evaluation
from aleator.nlp._program import Hessian as Hessian
from aleator.nlp._program import Magnitudes as Magnitudes
from aleator.nlp._program import NonlinearProgram as NonlinearProgram
from aleator.nlp._scaling import Multipliers as Multipliers
from aleator.nlp._scaling import ScaledProgram as ScaledProgram
from aleator.nlp._slsqp import Slsqp as Slsqp
from aleator.nlp._solver import AbstractSolver as AbstractSolver
from aleator.nlp._ties import Ties as Ties
from aleator.nlp._unmoved import moved_on as moved_on
from aleator.nlp._verdict import HELD as HELD
from aleator.nlp._verdict import Answer as Answer
