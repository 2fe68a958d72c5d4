"""Searches without derivatives, which know only values, and whose best point is polished by derivatives."""

from aleator.nlp.search._abstract import AbstractSearch as AbstractSearch
from aleator.nlp.search._methods import CmaEs as CmaEs
from aleator.nlp.search._methods import DifferentialEvolution as DifferentialEvolution
from aleator.nlp.search._methods import Direct as Direct
from aleator.nlp.search._methods import DualAnnealing as DualAnnealing
from aleator.nlp.search._methods import NelderMead as NelderMead
from aleator.nlp.search._methods import load_pymoo as load_pymoo
from aleator.nlp.search._methods import population_front as population_front
from aleator.nlp.search._sought import Sought as Sought
