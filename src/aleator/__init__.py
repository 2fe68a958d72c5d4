"""Optimal design of uncertain dynamical systems.

Write ordinary physics; put a distribution in the place of any number that is uncertain and a `Decision` in the place of
any number to choose; declare what to minimise subject to what; `solve`, `validate`, `report`.
"""

import time as _time
from types import ModuleType as _ModuleType

_started = _time.perf_counter()

from aleator import cost as cost  # noqa: E402
from aleator import fits as fits  # noqa: E402
from aleator import index_sets as index_sets  # noqa: E402
from aleator import integrators as integrators  # noqa: E402
from aleator import joints as joints  # noqa: E402
from aleator import objectives as objectives  # noqa: E402
from aleator import points as points  # noqa: E402
from aleator import processes as processes  # noqa: E402
from aleator import references as references  # noqa: E402
from aleator import reporting as reporting  # noqa: E402
from aleator import results as results  # noqa: E402
from aleator import schemes as schemes  # noqa: E402
from aleator import shapes as shapes  # noqa: E402
from aleator import solvers as solvers  # noqa: E402
from aleator._core import clock as _clock  # noqa: E402
from aleator._core.arrays import Number as Number  # noqa: E402
from aleator._core.beside import threads as threads  # noqa: E402
from aleator._core.errors import AleatorError as AleatorError  # noqa: E402
from aleator._core.errors import AleatorWarning as AleatorWarning  # noqa: E402
from aleator._core.errors import CalibrationWarning as CalibrationWarning  # noqa: E402
from aleator._core.errors import ExpansionWarning as ExpansionWarning  # noqa: E402
from aleator._core.errors import GridWarning as GridWarning  # noqa: E402
from aleator._core.errors import MissingExtraError as MissingExtraError  # noqa: E402
from aleator._core.errors import ProblemError as ProblemError  # noqa: E402
from aleator._core.errors import SimulationError as SimulationError  # noqa: E402
from aleator._core.errors import SolveError as SolveError  # noqa: E402
from aleator._core.kept_programs import compilation_cache as compilation_cache  # noqa: E402
from aleator.analysis import MultiElement as MultiElement  # noqa: E402
from aleator.analysis import expand as expand  # noqa: E402
from aleator.analysis import galerkin as galerkin  # noqa: E402
from aleator.analysis import tolerance_analysis as tolerance_analysis  # noqa: E402
from aleator.crosschecking import cross_check as cross_check  # noqa: E402
from aleator.design import Constraint as Constraint  # noqa: E402
from aleator.design import Control as Control  # noqa: E402
from aleator.design import Expression as Expression  # noqa: E402
from aleator.design import Problem as Problem  # noqa: E402
from aleator.design import correlation as correlation  # noqa: E402
from aleator.design import covariance as covariance  # noqa: E402
from aleator.design import deterministic as deterministic  # noqa: E402
from aleator.design import integral as integral  # noqa: E402
from aleator.design import output as output  # noqa: E402
from aleator.design import path as path  # noqa: E402
from aleator.design import peak as peak  # noqa: E402
from aleator.design import rms as rms  # noqa: E402
from aleator.design import terminal as terminal  # noqa: E402
from aleator.design import time_integral as time_integral  # noqa: E402
from aleator.design import uncertain as uncertain  # noqa: E402
from aleator.design import value as value  # noqa: E402
from aleator.dynamics import AlgebraicSystem as AlgebraicSystem  # noqa: E402
from aleator.dynamics import Assembly as Assembly  # noqa: E402
from aleator.dynamics import Grid as Grid  # noqa: E402
from aleator.dynamics import Instant as Instant  # noqa: E402
from aleator.dynamics import System as System  # noqa: E402
from aleator.dynamics import simulate as simulate  # noqa: E402
from aleator.expansion import Expansion as Expansion  # noqa: E402
from aleator.mechanics import Accelerations as Accelerations  # noqa: E402
from aleator.mechanics import Actuation as Actuation  # noqa: E402
from aleator.mechanics import Body as Body  # noqa: E402
from aleator.mechanics import BodyLoad as BodyLoad  # noqa: E402
from aleator.mechanics import ForwardDynamics as ForwardDynamics  # noqa: E402
from aleator.mechanics import HybridDynamics as HybridDynamics  # noqa: E402
from aleator.mechanics import InverseDynamics as InverseDynamics  # noqa: E402
from aleator.mechanics import Lagrangian as Lagrangian  # noqa: E402
from aleator.mechanics import Mechanical as Mechanical  # noqa: E402
from aleator.mechanics import Motion as Motion  # noqa: E402
from aleator.mechanics import Multibody as Multibody  # noqa: E402
from aleator.mechanics import actuation_of as actuation_of  # noqa: E402
from aleator.nlp import Status as Status  # noqa: E402
from aleator.reporting import report as report  # noqa: E402
from aleator.solution import Solution as Solution  # noqa: E402
from aleator.solving import solve as solve  # noqa: E402
from aleator.sweep import calibrate as calibrate  # noqa: E402
from aleator.sweep import multistart as multistart  # noqa: E402
from aleator.sweep import pareto as pareto  # noqa: E402
from aleator.trajectories import AbstractSignal as AbstractSignal  # noqa: E402
from aleator.trajectories import AbstractTrajectory as AbstractTrajectory  # noqa: E402
from aleator.trajectories import BSpline as BSpline  # noqa: E402
from aleator.trajectories import PowerSeries as PowerSeries  # noqa: E402
from aleator.trajectories import Tabulated as Tabulated  # noqa: E402
from aleator.trajectories import fit_control_points as fit_control_points  # noqa: E402
from aleator.transcription import Sequential as Sequential  # noqa: E402
from aleator.transcription import Simultaneous as Simultaneous  # noqa: E402
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
from aleator.validation import rare_violation as rare_violation  # noqa: E402
from aleator.validation import validate as validate  # noqa: E402

__version__ = "0.1.0"
_clock.import_seconds = _time.perf_counter() - _started

_TOPICS = {cost, fits, index_sets, integrators, joints, objectives, points, processes}
_TOPICS |= {references, reporting, results, schemes, shapes, solvers}


def __dir__() -> list[str]:
    """What is meant to be used: Python makes attributes of all packages that are imported."""
    shown = {name: one for name, one in globals().items() if not name.startswith("_")}
    return ["__version__", *(name for name, one in shown.items() if type(one) is not _ModuleType or one in _TOPICS)]
