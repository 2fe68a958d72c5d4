"""What results show of themselves: their figures (`result.plot`) and their tables in notebooks.

A new type of result derives from `Drawn` of `aleator.extending`. `figure(Type)` above a function of a result makes it
one of its figures; `facts_of.register` above another one makes that give its facts.
"""

from aleator.reporting import _fronts as _fronts
from aleator.reporting import _samples as _samples
from aleator.reporting import _solutions as _solutions
from aleator.reporting import _sweeps as _sweeps
from aleator.reporting._showing import Facts as Facts
from aleator.reporting._showing import Figures as Figures
from aleator.reporting._showing import facts_of as facts_of
from aleator.reporting._showing import figure as figure
from aleator.reporting._showing import page_of as page_of
from aleator.reporting._showing import plots_of as plots_of
