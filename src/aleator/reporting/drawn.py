"""What results show of themselves: their figures (`result.plot`) and their tables in notebooks.

`plots_of` and `facts_of` are functions of the type of a result (`functools.singledispatch`). A new type of result
derives from `Drawn` of `aleator._core.leaves` and is made known by one line for each: `plots_of.register(Type)` above a
class of figures, one method for each, and `facts_of.register(Type)` above the function that gives its facts.
"""

from aleator.reporting import _fronts as _fronts
from aleator.reporting import _samples as _samples
from aleator.reporting import _solutions as _solutions
from aleator.reporting import _sweeps as _sweeps
from aleator.reporting._showing import AbstractPlots as AbstractPlots
from aleator.reporting._showing import Facts as Facts
from aleator.reporting._showing import facts_of as facts_of
from aleator.reporting._showing import page_of as page_of
from aleator.reporting._showing import plots_of as plots_of
