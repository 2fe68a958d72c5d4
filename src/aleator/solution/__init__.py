"""The answer to a problem: its design, and what certifies it."""

from aleator.solution._certificate import COSTLY as COSTLY
from aleator.solution._certificate import TOLERATED as TOLERATED
from aleator.solution._certificate import Between as Between
from aleator.solution._certificate import Certificate as Certificate
from aleator.solution._certificate import ExpansionQuality as ExpansionQuality
from aleator.solution._certificate import Moments as Moments
from aleator.solution._certificate import Objection as Objection
from aleator.solution._certificate import SecondOpinion as SecondOpinion
from aleator.solution._certificate import Tangent as Tangent
from aleator.solution._certificate import WorstCase as WorstCase
from aleator.solution._certificate import WorstRealisation as WorstRealisation
from aleator.solution._certificate import ends as ends
from aleator.solution._grid import MOST_NUMBERS as MOST_NUMBERS
from aleator.solution._grid import Costates as Costates
from aleator.solution._grid import Deviation as Deviation
from aleator.solution._grid import GridError as GridError
from aleator.solution._grid import MeshError as MeshError
from aleator.solution._grid import States as States
from aleator.solution._grid import Switching as Switching
from aleator.solution._grid import system_text as system_text
from aleator.solution._solution import AtMeans as AtMeans
from aleator.solution._solution import ConstraintResult as ConstraintResult
from aleator.solution._solution import Effort as Effort
from aleator.solution._solution import Solution as Solution
from aleator.solution._solution import Times as Times
from aleator.solution._solution import in_brief as in_brief
