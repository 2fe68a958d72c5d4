"""Random processes as signals: sensor noise, actuator noise and forcing, for a problem's inputs."""

from aleator.trajectories import AbstractCovariance as AbstractCovariance
from aleator.trajectories import BandLimitedCovariance as BandLimitedCovariance
from aleator.trajectories import ExponentialCovariance as ExponentialCovariance
from aleator.trajectories import Parametrised as Parametrised
from aleator.trajectories import SquaredExponentialCovariance as SquaredExponentialCovariance
from aleator.trajectories import Total as Total
from aleator.trajectories import WhiteNoise as WhiteNoise
from aleator.trajectories import signal as signal
from aleator.trajectories import total as total
from aleator.uncertainty import RandomProcess as RandomProcess
