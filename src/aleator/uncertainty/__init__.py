"""From a model's leaves to the germ: distributions, their orthonormal polynomials, decisions, realisation."""

from aleator.uncertainty._decision import Decision as Decision
from aleator.uncertainty._distribution import AbstractDistribution as AbstractDistribution
from aleator.uncertainty._families import Beta as Beta
from aleator.uncertainty._families import Gamma as Gamma
from aleator.uncertainty._families import Normal as Normal
from aleator.uncertainty._families import Uniform as Uniform
from aleator.uncertainty._polynomials import AbstractGerm as AbstractGerm
from aleator.uncertainty._polynomials import HermiteGerm as HermiteGerm
from aleator.uncertainty._polynomials import JacobiGerm as JacobiGerm
from aleator.uncertainty._polynomials import LaguerreGerm as LaguerreGerm
from aleator.uncertainty._polynomials import LegendreGerm as LegendreGerm
from aleator.uncertainty._positive import fields_of as fields_of
from aleator.uncertainty._positive import parameter as parameter
from aleator.uncertainty._positive import refuse_nonpositive as refuse_nonpositive
from aleator.uncertainty._survey import Survey as Survey
from aleator.uncertainty._survey import at_means as at_means
from aleator.uncertainty._survey import named_numbers as named_numbers
from aleator.uncertainty._survey import realise as realise
from aleator.uncertainty._survey import survey as survey
from aleator.uncertainty._survey import uncertain_again as uncertain_again
from aleator.uncertainty._survey import uncertain_numbers as uncertain_numbers
