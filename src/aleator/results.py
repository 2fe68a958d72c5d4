"""What analyses, sweeps and evidence give back: for type hints and `isinstance`."""

from aleator.analysis import Contribution as Contribution
from aleator.analysis import ElementExpanded as ElementExpanded
from aleator.analysis import Expanded as Expanded
from aleator.analysis import ToleranceAnalysis as ToleranceAnalysis
from aleator.solution import Certificate as Certificate
from aleator.solution import ConstraintResult as ConstraintResult
from aleator.solution import Effort as Effort
from aleator.sweep import Calibration as Calibration
from aleator.sweep import Front as Front
from aleator.sweep import Refused as Refused
from aleator.sweep import Starts as Starts
from aleator.validation import Evidence as Evidence
from aleator.validation import Proportion as Proportion
from aleator.validation import WeightedProportion as WeightedProportion
