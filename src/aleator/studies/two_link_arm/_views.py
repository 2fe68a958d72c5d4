"""The two-link arm on pages: a drawing to scale, the arm among its surroundings."""

import numpy as np

import aleator as al
from aleator.reporting import Scene, Schematic
from aleator.studies._shared import Linkage, system
from aleator.studies._study import Draft
from aleator.studies.two_link_arm import OBSTACLE, TARGET, TORQUE

ARM = Linkage(
    elbow=lambda outputs: np.stack([outputs["elbow_x"], outputs["elbow_y"]], axis=-1),
    posture=TARGET,
    target=(float(np.cos(TARGET[0]) + np.cos(sum(TARGET))), float(np.sin(TARGET[0]) + np.sin(sum(TARGET)))),
    torques={"τ₁": "q1_torque", "τ₂": "q2_torque"},
    limit=TORQUE,
    limits=dict.fromkeys(("gap_1", "gap_2", "elbow_x", "tip_x"), (0.0, np.inf)),
    scene=Scene(((float(OBSTACLE.center[0]), float(OBSTACLE.center[1]), float(OBSTACLE.radius)),), wall=0.0),
)


def arm_schematic(page: Draft, payload: al.Uniform) -> Schematic:
    """The drawing with its caption, and the problems of a study beside it."""
    caption = (
        "To scale, seen from above: the arm at its start (solid) and at its target (dashed). Mass of the payload M in "
        f"kg: {payload}. Elbow and tip stay before the wall, both links clear of the obstacle."
    )
    return system(page, "two_link_arm/arm.svg", "Two-link arm", caption, "5.1")
