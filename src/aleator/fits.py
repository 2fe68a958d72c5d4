"""How the coefficients of an expansion follow from its samples: `al.Expansion(order, fit=al.fits.Sparse())`."""

from aleator.expansion import AbstractFit as AbstractFit
from aleator.expansion import Interpolation as Interpolation
from aleator.expansion import LeastSquares as LeastSquares
from aleator.expansion import Projection as Projection
from aleator.expansion import Sparse as Sparse
