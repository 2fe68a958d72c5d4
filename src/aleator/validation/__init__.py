"""Monte Carlo re-simulation of a design, independent of the expansion it checks."""

from aleator.validation._evidence import PERCENTILES as PERCENTILES
from aleator.validation._evidence import Checked as Checked
from aleator.validation._evidence import Compared as Compared
from aleator.validation._evidence import Disagreement as Disagreement
from aleator.validation._evidence import Evidence as Evidence
from aleator.validation._evidence import Sampled as Sampled
from aleator.validation._evidence import Trajectories as Trajectories
from aleator.validation._rare import rare_violation as rare_violation
from aleator.validation._shares import Proportion as Proportion
from aleator.validation._shares import Share as Share
from aleator.validation._shares import WeightedProportion as WeightedProportion
from aleator.validation._shares import reason_uncounted as reason_uncounted
from aleator.validation._validate import validate as validate
from aleator.validation._validate import validated_from as validated_from
