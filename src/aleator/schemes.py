"""How states follow their rates in a simultaneous program: `al.Simultaneous(al.schemes.Radau(3))`."""

from aleator.dynamics import AbstractScheme as AbstractScheme
from aleator.dynamics import GaussLegendre as GaussLegendre
from aleator.dynamics import HermiteSimpson as HermiteSimpson
from aleator.dynamics import MultipleShooting as MultipleShooting
from aleator.dynamics import Radau as Radau
from aleator.dynamics import Trapezoid as Trapezoid
