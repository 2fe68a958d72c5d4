"""Solvers of nonlinear programs: `al.solve(problem, al.solvers.Ipopt())`."""

from aleator.nlp import AbstractSolver as AbstractSolver
from aleator.nlp import Condensing as Condensing
from aleator.nlp import FilterSQP as FilterSQP
from aleator.nlp import InteriorPoint as InteriorPoint
from aleator.nlp import Ipopt as Ipopt
from aleator.nlp import Slsqp as Slsqp
