"""Functions of time: signals, and trajectories that fill a duration: B-splines, power series, values at nodes.

Knows no physics and no distributions; covariances of random processes are functions of time too.
"""

from aleator.trajectories._bspline import BSpline as BSpline
from aleator.trajectories._bspline import fit_control_points as fit_control_points
from aleator.trajectories._covariance import AbstractCovariance as AbstractCovariance
from aleator.trajectories._covariance import BandLimitedCovariance as BandLimitedCovariance
from aleator.trajectories._covariance import ExponentialCovariance as ExponentialCovariance
from aleator.trajectories._covariance import SquaredExponentialCovariance as SquaredExponentialCovariance
from aleator.trajectories._covariance import karhunen_loeve as karhunen_loeve
from aleator.trajectories._covariance import plain_number as plain_number
from aleator.trajectories._jumping import StepFunction as StepFunction
from aleator.trajectories._jumping import Tabulated as Tabulated
from aleator.trajectories._jumping import entry as entry
from aleator.trajectories._jumping import jumping_in as jumping_in
from aleator.trajectories._jumping import numbers_in as numbers_in
from aleator.trajectories._jumping import on_pieces as on_pieces
from aleator.trajectories._jumping import read_table as read_table
from aleator.trajectories._polynomials import Piecewise as Piecewise
from aleator.trajectories._polynomials import PowerSeries as PowerSeries
from aleator.trajectories._polynomials import before_jumps as before_jumps
from aleator.trajectories._polynomials import has_jumps as has_jumps
from aleator.trajectories._polynomials import jumps_of as jumps_of
from aleator.trajectories._polynomials import least_steps as least_steps
from aleator.trajectories._polynomials import piecewise_in as piecewise_in
from aleator.trajectories._signals import AbstractSignal as AbstractSignal
from aleator.trajectories._signals import AbstractTrajectory as AbstractTrajectory
from aleator.trajectories._signals import Parametrised as Parametrised
from aleator.trajectories._signals import Stack as Stack
from aleator.trajectories._signals import Total as Total
from aleator.trajectories._signals import WhiteNoise as WhiteNoise
from aleator.trajectories._signals import as_array as as_array
from aleator.trajectories._signals import common_span as common_span
from aleator.trajectories._signals import instants as instants
from aleator.trajectories._signals import signal as signal
from aleator.trajectories._signals import total as total
