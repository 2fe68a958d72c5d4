"""Which polynomials an expansion has: `al.Expansion(order, index_set=al.index_sets.HyperbolicCross(0.5))`."""

from aleator.expansion import AbstractIndexSet as AbstractIndexSet
from aleator.expansion import Adaptive as Adaptive
from aleator.expansion import Anisotropic as Anisotropic
from aleator.expansion import HyperbolicCross as HyperbolicCross
from aleator.expansion import TensorProduct as TensorProduct
from aleator.expansion import TotalDegree as TotalDegree
