"""The common views of the pick-and-place studies: the arm's joints, its surroundings, the names of its limits."""

import numpy as np
from jaxtyping import Bool, Float

from aleator.reporting import Scene
from aleator.studies._motion.family import Family
from aleator.studies._motion.views import Outputs, linkage
from aleator.studies.two_link_arm import OBSTACLE, TARGET

TIP = (np.cos(TARGET[0]) + np.cos(sum(TARGET)), np.sin(TARGET[0]) + np.sin(sum(TARGET)))
"""The target of the tip, m."""

SCENE = Scene(((float(OBSTACLE.center[0]), float(OBSTACLE.center[1]), float(OBSTACLE.radius)),), wall=0.0)

TOGETHER = {
    "q1_torque": "torque",
    "q2_torque": "torque",
    "gap_1": "obstacle",
    "gap_2": "obstacle",
    "elbow_x": "wall",
    "tip_x": "wall",
    **dict.fromkeys(("q1", "q2", "q1_rate", "q2_rate"), "target"),
}
"""The names of the limits of the arm's problems, by their outputs."""


def joints(outputs: Outputs) -> Float[np.ndarray, "... joints 2"]:
    """Base, elbow and tip, m."""
    return linkage(np.stack([outputs["elbow_x"], outputs["elbow_y"]], axis=-1), outputs)


def touches(family: Family) -> Bool[np.ndarray, " systems"]:
    """Which systems hit the obstacle or the wall at any time."""
    kept = ("gap_1", "gap_2", "elbow_x", "tip_x")
    return np.any([family.extremes[name][:, 0] < 0 for name in kept], axis=0)
