"""What results show of themselves: their figures (`result.plot`) and their tables in notebooks.

`plots_of` and `facts_of` are functions of the type of a result (`functools.singledispatch`). A new type of result
derives from `Drawn` of `aleator._core.leaves` and is made known by one line for each: `plots_of.register(Type, Plots)`,
and `@facts_of.register(Type)` above the function that gives its facts.
"""

from aleator.reporting.drawn import _designs as _designs
from aleator.reporting.drawn import _spreads as _spreads
from aleator.reporting.drawn import _sweeps as _sweeps
from aleator.reporting.drawn._facts import AbstractPlots as AbstractPlots
from aleator.reporting.drawn._facts import Facts as Facts
from aleator.reporting.drawn._facts import facts_of as facts_of
from aleator.reporting.drawn._facts import page_of as page_of
from aleator.reporting.drawn._facts import plots_of as plots_of
