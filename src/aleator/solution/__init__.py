"""The answer to a problem: its design, and what certifies it."""

from aleator.solution._between import TOLERATED as TOLERATED
from aleator.solution._between import Between as Between
from aleator.solution._brief import in_brief as in_brief
from aleator.solution._certificate import Certificate as Certificate
from aleator.solution._constraint import ConstraintResult as ConstraintResult
from aleator.solution._costates import Costates as Costates
from aleator.solution._costates import Switching as Switching
from aleator.solution._effort import AtMeans as AtMeans
from aleator.solution._effort import Effort as Effort
from aleator.solution._effort import Times as Times
from aleator.solution._expansion import ExpansionQuality as ExpansionQuality
from aleator.solution._expansion import Moments as Moments
from aleator.solution._expansion import Tangent as Tangent
from aleator.solution._expansion import ends as ends
from aleator.solution._grid_error import Deviation as Deviation
from aleator.solution._grid_error import GridError as GridError
from aleator.solution._mesh import MeshError as MeshError
from aleator.solution._opinion import SecondOpinion as SecondOpinion
from aleator.solution._solution import Solution as Solution
from aleator.solution._states import States as States
from aleator.solution._systems import system_text as system_text
from aleator.solution._worst_case import WorstCase as WorstCase
from aleator.solution._worst_case import WorstRealisation as WorstRealisation
