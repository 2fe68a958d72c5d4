"""From samples at germ points to the coefficients of an expansion: index sets, points, the collocation matrix."""

from aleator.collocation._collocation import Collocation as Collocation
from aleator.collocation._collocation import Expansion as Expansion
from aleator.collocation._collocation import collocate as collocate
from aleator.collocation._collocation import collocation_matrix as collocation_matrix
from aleator.collocation._collocation import leave_one_out as leave_one_out
from aleator.collocation._index_set import total_degree as total_degree
from aleator.collocation._points import hammersley as hammersley
