"""Feedback around a plan, and white noise by the covariance of the states. Knows no expansions."""

from aleator.feedback._closed_loop import ClosedLoop as ClosedLoop
from aleator.feedback._closed_loop import Feedback as Feedback
from aleator.feedback._closed_loop import closed_loop as closed_loop
from aleator.feedback._controllers import AbstractController as AbstractController
from aleator.feedback._controllers import Plan as Plan
from aleator.feedback._controllers import computed_torque as computed_torque
from aleator.feedback._lqr import lqr as lqr
from aleator.feedback._noisy import VARIANCE as VARIANCE
from aleator.feedback._noisy import Noisy as Noisy
from aleator.feedback._noisy import noisy as noisy
from aleator.feedback._noisy import surrounded as surrounded
