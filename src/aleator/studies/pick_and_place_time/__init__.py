"""Pick and place in minimum time: inverse dynamics (dissertation, section 5.5.2).

The joints follow B-splines exactly, whatever the payload; the payload changes the torques needed. The robust plan is
the fastest whose torques stay within their limits by `sigmas` standard deviations (equation 91).
"""

import numpy as np

import aleator as al
from aleator.studies.two_link_arm import (
    OBSTACLE,
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


def deterministic_problem(
    obstacle: al.shapes.Sphere | None = OBSTACLE,
    *,
    free: int = FREE,
    steps: int = INSTANTS,
    guess: np.ndarray | None = None,
) -> al.Problem:
    """The fastest plan for the mean payload (73)."""
    return al.deterministic(robust_problem(0.0, obstacle, free=free, steps=steps, guess=guess))


def robust_problem(
    sigmas: float = 1.0,
    obstacle: al.shapes.Sphere | None = OBSTACLE,
    *,
    free: int = FREE,
    steps: int = INSTANTS,
    guess: np.ndarray | None = None,
) -> al.Problem:
    """The fastest plan whose torques keep `sigmas` standard deviations from their limits (80), (91).

    `guess` are the control points to start from; by default those of `bent_path`.
    """
    arm = TwoLinkArm(payload=PAYLOAD, obstacle=obstacle)
    plan = al.InverseDynamics(arm, motion=motion(free, guess))
    torques = [al.path(name).within(-TORQUE, TORQUE, sigmas=sigmas).named("torque") for name in arm.actuators]
    return al.Problem(
        plan,
        grid=al.Grid(al.Decision(2.0, 0.5, 6.0), steps),
        minimize=al.objectives.final_time(),
        subject_to=[*torques, *clear_of_wall_and_obstacle(arm)],
        expansion=al.Expansion(order=5),
    )


def motion(free: int = FREE, guess: np.ndarray | None = None) -> al.BSpline:
    """Both joints' clamped cubic B-splines, from rest to rest."""
    points = al.fit_control_points(bent_path(), free, start=(START, 0), end=(TARGET, 0)) if guess is None else guess
    return al.BSpline(al.Decision(points, -3.0, 3.0), start=(START, 0), end=(TARGET, 0))
