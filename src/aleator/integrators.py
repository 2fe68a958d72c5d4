"""How states are carried forward: `al.Problem(..., integrator=al.integrators.Rodas5P())`."""

from aleator.dynamics import AbstractIntegrator as AbstractIntegrator
from aleator.dynamics import Rodas5P as Rodas5P
from aleator.dynamics import RungeKutta4 as RungeKutta4
from aleator.dynamics import Tsit5 as Tsit5
