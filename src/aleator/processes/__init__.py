"""Random processes as signals: sensor noise, actuator noise and forcing, for a problem's inputs."""

from aleator.processes._covariance import AbstractCovariance as AbstractCovariance
from aleator.processes._covariance import BandLimitedCovariance as BandLimitedCovariance
from aleator.processes._covariance import ExponentialCovariance as ExponentialCovariance
from aleator.processes._covariance import SquaredExponentialCovariance as SquaredExponentialCovariance
from aleator.processes._signals import Parametrised as Parametrised
from aleator.processes._signals import RandomProcess as RandomProcess
from aleator.processes._signals import Total as Total
from aleator.processes._signals import signal as signal
from aleator.processes._signals import total as total
