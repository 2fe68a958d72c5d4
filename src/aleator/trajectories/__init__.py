"""Functions of time: signals, and trajectories that fill a duration: B-splines and power series. Knows no physics."""

from aleator.trajectories._bspline import BSpline as BSpline
from aleator.trajectories._bspline import fit_control_points as fit_control_points
from aleator.trajectories._power_series import PowerSeries as PowerSeries
from aleator.trajectories._signal import AbstractSignal as AbstractSignal
from aleator.trajectories._signal import instants as instants
from aleator.trajectories._tabulated import Tabulated as Tabulated
from aleator.trajectories._trajectory import AbstractTrajectory as AbstractTrajectory
from aleator.trajectories._trajectory import Stack as Stack
