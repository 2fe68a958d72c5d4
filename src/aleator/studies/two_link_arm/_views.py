"""The two-link arm on pages: a drawing to scale, the arm among its surroundings."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool

import aleator as al
from aleator.reporting import Code, Scene, Schematic
from aleator.studies._motion import Linkage
from aleator.studies._shared import picture
from aleator.studies.two_link_arm import OBSTACLE, TARGET

ARM = Linkage(
    elbow=lambda outputs: np.stack([outputs["elbow_x"], outputs["elbow_y"]], axis=-1),
    posture=TARGET,
    target=(np.cos(TARGET[0]) + np.cos(sum(TARGET)), np.sin(TARGET[0]) + np.sin(sum(TARGET))),
    scene=Scene(((float(OBSTACLE.center[0]), float(OBSTACLE.center[1]), float(OBSTACLE.radius)),), wall=0.0),
)
TORQUES = {"τ₁": "q1_torque", "τ₂": "q2_torque"}


def touches(family: al.results.Motions) -> Bool[np.ndarray, " systems"]:
    """Which systems hit the obstacle or the wall at an instant."""
    return np.any([family.systems[name].min(axis=1) < 0 for name in ("gap_1", "gap_2", "elbow_x", "tip_x")], axis=0)


def arm_schematic(payload: al.Uniform, problems: Mapping[str, al.Problem]) -> Schematic:
    """The drawing with its caption, and the problems of a study beside it."""
    caption = (
        "To scale, seen from above: the arm at its start (solid) and at its target (dashed). Mass of the payload M in "
        f"kg: {payload}. Elbow and tip stay before the wall, both links clear of the obstacle."
    )
    texts = [Code(f"{name.capitalize()} plan as mathematics", str(problem)) for name, problem in problems.items()]
    return Schematic([picture("two_link_arm/arm.svg")], "Two-link arm", caption, "5.1", texts)
