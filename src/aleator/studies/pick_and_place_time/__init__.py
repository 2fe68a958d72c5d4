"""Pick and place in minimum time: inverse dynamics (dissertation, section 5.5.2).

The joints follow B-splines exactly, whatever the payload; the payload changes the torques needed. The robust plan is
the fastest whose torques stay within their limits by `sigmas` standard deviations (equation 91).
"""

from typing import Any

import numpy as np

import aleator as al
from aleator.studies.two_link_arm import (
    START,
    TARGET,
    TORQUE,
    TwoLinkArm,
    bent_path,
    clear_of_wall_and_obstacle,
)

PAYLOAD = al.Uniform(1.0, std=0.5)
FREE = 8
"""Free control points per joint: of 12, two at each end make the motion start and end at rest."""

INSTANTS = 90
"""Steps of the grid: nine spans of ten, so that all knots are among the instants."""


def deterministic_problem() -> al.Problem:
    """The fastest plan for the mean payload (73)."""
    return al.deterministic(robust_problem(0.0))


def robust_problem(sigmas: float = 1.0, *, guess: np.ndarray | None = None) -> al.Problem:
    """The fastest plan whose torques keep `sigmas` standard deviations from their limits (80), (91).

    `guess` are the control points to start from; by default those of `bent_path`. Both joints follow clamped cubic
    B-splines, from rest to rest.
    """
    arm = TwoLinkArm(payload=PAYLOAD)
    ends: dict[str, Any] = {"start": (START, 0), "end": (TARGET, 0)}
    points = al.fit_control_points(bent_path(), FREE, **ends) if guess is None else guess
    torques = [al.path(name).within(-TORQUE, TORQUE, sigmas=sigmas).named("torque") for name in arm.actuators]
    return al.Problem(
        al.InverseDynamics(arm, motion=al.BSpline(al.Decision(points, -3.0, 3.0), **ends)),
        grid=al.Grid(al.Decision(2.0, 0.5, 6.0), INSTANTS),
        minimize=al.objectives.final_time(),
        subject_to=[*torques, *clear_of_wall_and_obstacle()],
        expansion=al.Expansion(order=5),
    )
