"""Solvers of nonlinear programs: `al.solve(problem, al.solvers.Ipopt())`.

By derivatives: `FilterSQP`, `Ipopt`, `Slsqp`, `InteriorPoint`. Without, and then polished by them:
`NelderMead`, `Direct`, `DifferentialEvolution`, `DualAnnealing`, `CmaEs`.
"""

from aleator.nlp import AbstractSolver as AbstractSolver
from aleator.nlp import CmaEs as CmaEs
from aleator.nlp import DifferentialEvolution as DifferentialEvolution
from aleator.nlp import Direct as Direct
from aleator.nlp import DualAnnealing as DualAnnealing
from aleator.nlp import FilterSQP as FilterSQP
from aleator.nlp import InteriorPoint as InteriorPoint
from aleator.nlp import Ipopt as Ipopt
from aleator.nlp import NelderMead as NelderMead
from aleator.nlp import Slsqp as Slsqp
