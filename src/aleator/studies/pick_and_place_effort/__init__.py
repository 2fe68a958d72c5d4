"""Pick and place with minimum effort: forward dynamics (dissertation, section 5.5.1).

The torques are planned and act alike on every arm of the family, so that the payload changes the motion. The robust
plan brings the mean motion to its target and keeps its spread away from obstacle and wall (79), (90); a third plan
minimises the spread at the end (86).
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

PAYLOAD = al.Uniform(1.0, std=0.1)
DURATION = 1.5
STEPS = 90
FREE = 12
"""Control points per joint, all free: torques need not start or end at zero."""

TORQUES = ("q1_torque", "q2_torque")
TIP = ("tip_x", "tip_y")


TOLERANCE = 0.15
"""Order 5 misses the joints' final rates by a tenth of their spread, but only their means are limited. The distances,
whose spreads matter, have an error of a fiftieth.
"""


def deterministic_problem() -> al.Problem:
    """The plan of minimum effort for the mean payload (72)."""
    return al.deterministic(robust_problem(0.0))


def robust_problem(
    sigmas: float = 1.0, *, payload: al.Uniform = PAYLOAD, guess: np.ndarray | None = None
) -> al.Problem:
    """The plan of minimum effort with `sigmas` standard deviations of clearance, on target in the mean."""
    return _problem(al.objectives.effort(*TORQUES), sigmas, payload, guess)


def terminal_variance_problem(effort: float, *, guess: np.ndarray | None = None) -> al.Problem:
    """The plan with the smallest final spread of the tip (86), with one standard deviation of clearance and a bound on
    the effort.
    """
    limit = (al.objectives.effort(*TORQUES) <= effort).named("effort")
    return _problem(al.objectives.terminal_variance(*TIP), 1.0, PAYLOAD, guess, limit)


def _problem(
    objective: al.Expression, sigmas: float, payload: al.Uniform, guess: np.ndarray | None, *limits: al.Constraint
) -> al.Problem:
    arm = TwoLinkArm(payload=payload)
    torque = al.BSpline(al.Decision(start_torques() if guess is None else guess, -TORQUE, TORQUE))
    return al.Problem(
        al.ForwardDynamics(arm, torque=torque, start=dict(zip(arm.names, START, strict=True))),
        grid=al.Grid(DURATION, STEPS),
        minimize=objective,
        subject_to=[*on_target(), *clear_of_wall_and_obstacle(sigmas), *limits],
        expansion=al.Expansion(order=5, tolerance=TOLERANCE),
    )


def on_target() -> list[al.Constraint]:
    """In the mean, the arm ends in the target posture, at rest."""
    posture = zip(("q1", "q2"), TARGET, strict=True)
    ends = {**dict(posture), "q1_rate": 0.0, "q2_rate": 0.0}
    return [al.terminal(name).mean.equals(end).named("target") for name, end in ends.items()]


def start_torques(bend: float = 1.9) -> np.ndarray:
    """Control points of the torques that move the mean arm along `bent_path`. From torques at random, most searches
    fail.
    """
    ends: dict[str, Any] = {"start": (START, 0, 0), "end": (TARGET, 0, 0)}
    motion = al.BSpline(al.fit_control_points(bent_path(bend), 10, degree=5, **ends), degree=5, **ends)
    found = al.simulate(
        al.InverseDynamics(TwoLinkArm(payload=1.0), motion=motion), al.Grid(DURATION, STEPS), only=TORQUES
    )
    torques = np.stack([np.asarray(found[name]) for name in TORQUES], axis=1)
    return np.clip(al.fit_control_points(torques, FREE), -TORQUE, TORQUE)
