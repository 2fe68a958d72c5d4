"""Optimal design of uncertain dynamical systems.

Write ordinary physics; put a distribution in the place of any number that is uncertain and a `Decision` in the place of
any number to choose; declare what to minimise subject to what; `solve`, `validate`, `report`.
"""

import time as _time

_started = _time.perf_counter()

from aleator._core import clock as _clock  # noqa: E402
from aleator._core.arrays import Number as Number  # noqa: E402
from aleator._core.errors import AleatorError as AleatorError  # noqa: E402
from aleator._core.errors import ExpansionWarning as ExpansionWarning  # noqa: E402
from aleator._core.errors import MissingExtraError as MissingExtraError  # noqa: E402
from aleator._core.errors import ProblemError as ProblemError  # noqa: E402
from aleator._core.errors import SimulationError as SimulationError  # noqa: E402
from aleator._core.errors import SolveError as SolveError  # noqa: E402
from aleator.collocation import Expansion as Expansion  # noqa: E402
from aleator.design import Constraint as Constraint  # noqa: E402
from aleator.design import Problem as Problem  # noqa: E402
from aleator.design import Solution as Solution  # noqa: E402
from aleator.design import cost_curve as cost_curve  # noqa: E402
from aleator.design import deterministic as deterministic  # noqa: E402
from aleator.design import exponential as exponential  # noqa: E402
from aleator.design import integral as integral  # noqa: E402
from aleator.design import path as path  # noqa: E402
from aleator.design import peak as peak  # noqa: E402
from aleator.design import reciprocal as reciprocal  # noqa: E402
from aleator.design import reciprocal_power as reciprocal_power  # noqa: E402
from aleator.design import reciprocal_squared as reciprocal_squared  # noqa: E402
from aleator.design import rms as rms  # noqa: E402
from aleator.design import terminal as terminal  # noqa: E402
from aleator.design import uncertain as uncertain  # noqa: E402
from aleator.design import value as value  # noqa: E402
from aleator.dynamics import AbstractSignal as AbstractSignal  # noqa: E402
from aleator.dynamics import Grid as Grid  # noqa: E402
from aleator.dynamics import Kvaerno5 as Kvaerno5  # noqa: E402
from aleator.dynamics import RungeKutta4 as RungeKutta4  # noqa: E402
from aleator.dynamics import System as System  # noqa: E402
from aleator.dynamics import Tabulated as Tabulated  # noqa: E402
from aleator.dynamics import Tsit5 as Tsit5  # noqa: E402
from aleator.dynamics import simulate as simulate  # noqa: E402
from aleator.nlp import FilterSQP as FilterSQP  # noqa: E402
from aleator.nlp import Ipopt as Ipopt  # noqa: E402
from aleator.nlp import Slsqp as Slsqp  # noqa: E402
from aleator.nlp import Status as Status  # noqa: E402
from aleator.report import report as report  # noqa: E402
from aleator.solve import solve as solve  # noqa: E402
from aleator.sweep import Calibration as Calibration  # noqa: E402
from aleator.sweep import Front as Front  # noqa: E402
from aleator.sweep import calibrate as calibrate  # noqa: E402
from aleator.sweep import pareto as pareto  # noqa: E402
from aleator.uncertainty import Beta as Beta  # noqa: E402
from aleator.uncertainty import Decision as Decision  # noqa: E402
from aleator.uncertainty import Gamma as Gamma  # noqa: E402
from aleator.uncertainty import Normal as Normal  # noqa: E402
from aleator.uncertainty import Uniform as Uniform  # noqa: E402
from aleator.uncertainty import parameter as parameter  # noqa: E402
from aleator.validation import Evidence as Evidence  # noqa: E402
from aleator.validation import validate as validate  # noqa: E402

__version__ = "0.1.0"
_clock.import_seconds = _time.perf_counter() - _started
