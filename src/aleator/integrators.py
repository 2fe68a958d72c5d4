"""How states are carried forward: `al.Problem(..., integrator=al.integrators.Kvaerno5())`."""

from aleator.dynamics import AbstractIntegrator as AbstractIntegrator
from aleator.dynamics import Kvaerno5 as Kvaerno5
from aleator.dynamics import RungeKutta4 as RungeKutta4
from aleator.dynamics import Tsit5 as Tsit5
