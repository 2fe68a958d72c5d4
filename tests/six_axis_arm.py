"""The fastest pick and place of an industrial six-axis arm with a payload of uncertain mass and centre of mass.

The arm is a UR5e (its masses, inertias and frames are public: see the head of `ur5e.csv`). Its joints follow B-splines;
torques follow by inverse dynamics, and their means and spreads stay within limits just sufficient to hold the
heaviest payload. The straight line in joint space would hit a pillar.
"""

import csv
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import aleator as al

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
START = np.deg2rad([-60.0, -60.0, 100.0, -130.0, -90.0, 0.0])
TARGET = np.deg2rad([60.0, -75.0, 90.0, -105.0, -90.0, 90.0])
SHARE_OF_TORQUE = 0.36
"""The share of the catalogue's peak torques allowed: just above the holding torques for the heaviest payload."""

PAYLOAD = al.Uniform(2.0, half_width=0.8)
OFFSET = al.Uniform(0.05, half_width=0.03)
PILLAR = al.shapes.Capsule((-0.6, 0.0, 0.0), (-0.6, 0.0, 0.5), 0.06)
FLOOR = 0.10
FREE = 8
STEPS = 63
"""Nine spans of seven steps: all knots are among the instants."""

DURATION = 0.8


def _table() -> list[dict[str, Any]]:
    """One row per joint with the link behind it, from public data."""
    text = (Path(__file__).parent / "ur5e.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return [{key: value if key == "joint" else float(value) for key, value in row.items()} for row in rows]


LINKS = _table()


class SixAxisArm(al.Multibody):
    """Six revolute joints and a point mass `offset` beyond the flange, along the tool's axis."""

    units: ClassVar = {
        **dict.fromkeys(JOINTS, "rad"),
        **{f"{name}_rate": "rad/s" for name in JOINTS},
        **{f"{name}_torque": "N m" for name in JOINTS},
        **dict.fromkeys(("height", "forearm_gap", "tool_gap"), "m"),
    }

    payload: al.Number = al.parameter("kg", positive=True)
    offset: al.Number = al.parameter("m")
    pillar: al.shapes.Capsule = PILLAR

    def bodies(self) -> tuple[al.Body, ...]:
        """The links of the table, and the payload."""
        parents = (None, *JOINTS)
        links = [_link(row, parent) for row, parent in zip(LINKS, parents, strict=False)]
        load = al.Body(
            "load", parent="wrist_3", joint=al.joints.Fixed(), position=(0.0, 0.0, self.offset), mass=self.payload
        )
        return (*links, load)

    def outputs(self, motion: al.Motion) -> dict[str, Any]:
        """The height of the tool, and the distances of forearm and tool from the pillar, m."""
        tool = self.point(motion.q, "wrist_3", (0.0, 0.0, 0.05))
        near, far = (self.point(motion.q, "elbow", (x, 0.0, 0.0265)) for x in (0.0, -0.3922))
        return {
            "height": tool[2],
            "forearm_gap": al.shapes.distance(al.shapes.Capsule(near, far, 0.06), self.pillar),
            "tool_gap": al.shapes.distance(al.shapes.Sphere(tool, 0.10), self.pillar),
        }


def _link(row: dict[str, Any], parent: str | None) -> al.Body:
    return al.Body(
        row["joint"],
        parent=parent,
        joint=al.joints.Revolute("z"),
        position=(row["x"], row["y"], row["z"]),
        orientation=(row["roll"], row["pitch"], row["yaw"]),
        mass=row["mass"],
        center=(row["centre_x"], row["centre_y"], row["centre_z"]),
        inertia=(row["ixx"], row["iyy"], row["izz"], row["ixy"], row["ixz"], row["iyz"]),
    )


def robust_problem(sigmas: float = 1.0) -> al.Problem:
    """The fastest plan whose torques keep `sigmas` standard deviations from their limits."""
    arm = SixAxisArm(payload=PAYLOAD, offset=OFFSET)
    ends: dict[str, Any] = {"start": (START, 0.0), "end": (TARGET, 0.0)}
    points = al.fit_control_points(raised_path(), FREE, **ends)
    reach = np.array([row["position_limit"] for row in LINKS])
    motion = al.BSpline(al.Decision(points, *np.broadcast_arrays(-reach, reach, points)[:2]), **ends)
    torque = {row["joint"]: SHARE_OF_TORQUE * row["torque_limit"] for row in LINKS}
    return al.Problem(
        al.InverseDynamics(arm, motion=motion),
        grid=al.Grid(al.Decision(DURATION, 0.1, 20.0), STEPS),
        minimize=al.objectives.final_time(),
        subject_to=[
            *(al.path(f"{name}_torque").within(-limit, limit, sigmas=sigmas) for name, limit in torque.items()),
            *(al.path(f"{row['joint']}_rate").within(-row["speed_limit"], row["speed_limit"]) for row in LINKS),
            al.path("height").at_least(FLOOR),
            *(al.path(name).at_least(0.0) for name in ("tool_gap", "forearm_gap")),
        ],
        expansion=al.Expansion(order=3),
    )


def raised_path(instants: int = 50) -> np.ndarray:
    """A path from start to target that raises the upper arm in the middle, the wrist keeping its tool down.

    From the straight line in joint space, through the pillar, some searches end at a plan of three seconds.
    """
    fractions = np.linspace(0.0, 1.0, instants)[:, None]
    raised = np.sin(np.pi * fractions) ** 2 * np.array([0.0, -0.3, 0.0, 0.3, 0.0, 0.0])
    return START + fractions * (TARGET - START) + raised
