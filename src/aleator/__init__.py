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
from aleator.analysis import Contribution as Contribution  # noqa: E402
from aleator.analysis import ElementExpanded as ElementExpanded  # noqa: E402
from aleator.analysis import Expanded as Expanded  # noqa: E402
from aleator.analysis import MultiElement as MultiElement  # noqa: E402
from aleator.analysis import ToleranceAnalysis as ToleranceAnalysis  # noqa: E402
from aleator.analysis import expand as expand  # noqa: E402
from aleator.analysis import galerkin as galerkin  # noqa: E402
from aleator.analysis import tolerance_analysis as tolerance_analysis  # noqa: E402
from aleator.collocation import Adaptive as Adaptive  # noqa: E402
from aleator.collocation import Anisotropic as Anisotropic  # noqa: E402
from aleator.collocation import ChristoffelPoints as ChristoffelPoints  # noqa: E402
from aleator.collocation import Expansion as Expansion  # noqa: E402
from aleator.collocation import GaussPoints as GaussPoints  # noqa: E402
from aleator.collocation import HaltonPoints as HaltonPoints  # noqa: E402
from aleator.collocation import HammersleyPoints as HammersleyPoints  # noqa: E402
from aleator.collocation import HyperbolicCross as HyperbolicCross  # noqa: E402
from aleator.collocation import Interpolation as Interpolation  # noqa: E402
from aleator.collocation import LatinHypercubePoints as LatinHypercubePoints  # noqa: E402
from aleator.collocation import LeastSquares as LeastSquares  # noqa: E402
from aleator.collocation import OptimalPoints as OptimalPoints  # noqa: E402
from aleator.collocation import Projection as Projection  # noqa: E402
from aleator.collocation import RandomPoints as RandomPoints  # noqa: E402
from aleator.collocation import SmolyakPoints as SmolyakPoints  # noqa: E402
from aleator.collocation import SobolPoints as SobolPoints  # noqa: E402
from aleator.collocation import Sparse as Sparse  # noqa: E402
from aleator.collocation import TensorProduct as TensorProduct  # noqa: E402
from aleator.collocation import TotalDegree as TotalDegree  # noqa: E402
from aleator.design import Constraint as Constraint  # noqa: E402
from aleator.design import Problem as Problem  # noqa: E402
from aleator.design import Solution as Solution  # noqa: E402
from aleator.design import correlation as correlation  # noqa: E402
from aleator.design import cost_curve as cost_curve  # noqa: E402
from aleator.design import covariance as covariance  # noqa: E402
from aleator.design import deterministic as deterministic  # noqa: E402
from aleator.design import exponential as exponential  # noqa: E402
from aleator.design import integral as integral  # noqa: E402
from aleator.design import output as output  # noqa: E402
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
from aleator.dynamics import AlgebraicSystem as AlgebraicSystem  # noqa: E402
from aleator.dynamics import Assembly as Assembly  # noqa: E402
from aleator.dynamics import Grid as Grid  # noqa: E402
from aleator.dynamics import Instant as Instant  # noqa: E402
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
from aleator.processes import AbstractCovariance as AbstractCovariance  # noqa: E402
from aleator.processes import BandLimitedCovariance as BandLimitedCovariance  # noqa: E402
from aleator.processes import ExponentialCovariance as ExponentialCovariance  # noqa: E402
from aleator.processes import RandomProcess as RandomProcess  # noqa: E402
from aleator.processes import SquaredExponentialCovariance as SquaredExponentialCovariance  # noqa: E402
from aleator.processes import signal as signal  # noqa: E402
from aleator.processes import total as total  # noqa: E402
from aleator.references import Estimate as Estimate  # noqa: E402
from aleator.references import Linearised as Linearised  # noqa: E402
from aleator.references import RandomSample as RandomSample  # noqa: E402
from aleator.references import SecondOrder as SecondOrder  # noqa: E402
from aleator.references import SobolIndices as SobolIndices  # noqa: E402
from aleator.references import linearise as linearise  # noqa: E402
from aleator.references import monte_carlo as monte_carlo  # noqa: E402
from aleator.references import quasi_monte_carlo as quasi_monte_carlo  # noqa: E402
from aleator.references import second_order as second_order  # noqa: E402
from aleator.references import sobol_indices as sobol_indices  # noqa: E402
from aleator.report import report as report  # noqa: E402
from aleator.solve import solve as solve  # noqa: E402
from aleator.sweep import Calibration as Calibration  # noqa: E402
from aleator.sweep import Front as Front  # noqa: E402
from aleator.sweep import calibrate as calibrate  # noqa: E402
from aleator.sweep import pareto as pareto  # noqa: E402
from aleator.uncertainty import Beta as Beta  # noqa: E402
from aleator.uncertainty import Decision as Decision  # noqa: E402
from aleator.uncertainty import Density as Density  # noqa: E402
from aleator.uncertainty import Exponential as Exponential  # noqa: E402
from aleator.uncertainty import Gamma as Gamma  # noqa: E402
from aleator.uncertainty import Gumbel as Gumbel  # noqa: E402
from aleator.uncertainty import LogNormal as LogNormal  # noqa: E402
from aleator.uncertainty import Normal as Normal  # noqa: E402
from aleator.uncertainty import Sample as Sample  # noqa: E402
from aleator.uncertainty import Toleranced as Toleranced  # noqa: E402
from aleator.uncertainty import Triangular as Triangular  # noqa: E402
from aleator.uncertainty import TruncatedNormal as TruncatedNormal  # noqa: E402
from aleator.uncertainty import Uniform as Uniform  # noqa: E402
from aleator.uncertainty import Weibull as Weibull  # noqa: E402
from aleator.uncertainty import correlated as correlated  # noqa: E402
from aleator.uncertainty import parameter as parameter  # noqa: E402
from aleator.uncertainty import toleranced as toleranced  # noqa: E402
from aleator.validation import Evidence as Evidence  # noqa: E402
from aleator.validation import validate as validate  # noqa: E402

__version__ = "0.1.0"
_clock.import_seconds = _time.perf_counter() - _started
