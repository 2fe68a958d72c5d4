"""The two-link arm on pages: a drawing to scale, the arm among its surroundings."""

import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

import aleator as al
from aleator.reporting import Code, Scene, Schematic, given, sketch
from aleator.reporting.sketch import Point, View
from aleator.studies._motion import Linkage
from aleator.studies.two_link_arm import OBSTACLE, START, TARGET, TwoLinkArm

ARM = Linkage(
    elbow=lambda outputs: np.stack([outputs["elbow_x"], outputs["elbow_y"]], axis=-1),
    posture=TARGET,
    target=(np.cos(TARGET[0]) + np.cos(sum(TARGET)), np.sin(TARGET[0]) + np.sin(sum(TARGET))),
    scene=Scene(((float(OBSTACLE.center[0]), float(OBSTACLE.center[1]), float(OBSTACLE.radius)),), wall=0.0),
)
TORQUES = {"τ₁": "q1_torque", "τ₂": "q2_torque"}

WIDTH, MARGIN = 420.0, 34.0
REACH = 250.0
"""Pixels along the longer path, that of both links."""


def touches(family: al.results.Motions) -> Bool[np.ndarray, " systems"]:
    """Which systems hit the obstacle or the wall at an instant."""
    return np.any([family.systems[name].min(axis=1) < 0 for name in ("gap_1", "gap_2", "elbow_x", "tip_x")], axis=0)


def arm_drawing(arm: TwoLinkArm, start: Sequence[float] = START, target: Sequence[float] = TARGET) -> str:
    """The arm (with numbers for its lengths) at its start, solid, and at its target, dashed, as SVG."""
    lengths = [float(arm.length_1), float(arm.length_2)]  # pyright: ignore[reportArgumentType]
    scale = REACH / sum(lengths)
    heights = [float(place[1]) for q in (start, target) for place in arm.places(jnp.array(q))]
    top, bottom = max(heights), min(heights)
    if arm.obstacle is not None:
        top = max(top, float(arm.obstacle.center[1] + arm.obstacle.radius))
    at = View((70.0, MARGIN + scale * max(top, 0.0)), scale)
    height = 2 * MARGIN + scale * (max(top, 0.0) - min(bottom, 0.0))
    wall = at(0, 0)[0]
    parts = [
        sketch.ground((wall, 8), (wall, height - 8), kind="wall"),
        sketch.label((wall - 16, height - 14), "wall", anchor="end"),
        *_posture(arm, start, at, "start", ""),
        *_posture(arm, target, at, "target", sketch.DASHED),
        *_angles(arm, start, at),
        *_lengths(arm, target, at, lengths),
    ]
    if arm.obstacle is not None:
        centre = at(float(arm.obstacle.center[0]), float(arm.obstacle.center[1]))
        parts += [
            sketch.circle(centre, scale * float(arm.obstacle.radius), kind="obstacle"),
            sketch.label((centre[0], centre[1] - 2), "obstacle", size=13.0),
            sketch.label((centre[0], centre[1] + 14), f"r = {given(float(arm.obstacle.radius), 'm')}", size=13.0),
        ]
    title = "Two-link arm before a wall, at its start and at its target, with a payload at its tip and an obstacle"
    return sketch.drawing(parts, width=WIDTH, height=height, title=title)


def arm_schematic(payload: al.Uniform, problems: Mapping[str, al.Problem]) -> Schematic:
    """The drawing with its caption, and the problems of a study beside it."""
    caption = (
        "To scale, seen from above: the arm at its start (solid) and at its target (dashed). Mass of the payload M in "
        f"kg: {payload}. Elbow and tip stay before the wall, both links clear of the obstacle."
    )
    drawing = arm_drawing(TwoLinkArm(payload=payload, obstacle=OBSTACLE))
    texts = [Code(f"{name.capitalize()} plan as mathematics", str(problem)) for name, problem in problems.items()]
    return Schematic([drawing], "Two-link arm", caption, "5.1", texts)


def _posture(arm: TwoLinkArm, q: Sequence[float], at: View, kind: str, dash: str) -> list[str]:
    """Both links, joints and the payload."""
    base, elbow, tip = _points(arm, q, at)
    return [
        sketch.path([base, elbow, tip], kind=kind, width=5.0 if not dash else 2.5, dash=dash),
        *(sketch.circle(place, 5.0, filled=True) for place in (base, elbow)),
        sketch.circle(tip, 11.0, kind=f"payload-{kind}", filled=not dash),
        sketch.label((tip[0] + 20, tip[1] + 5), f"{kind}, M(ξ)" if not dash else kind, anchor="start"),
    ]


def _angles(arm: TwoLinkArm, q: Sequence[float], at: View) -> list[str]:
    """The joints' angles at a posture, and their torques."""
    base, elbow, _ = _points(arm, q, at)
    first, second = math.degrees(q[0]), math.degrees(q[0] + q[1])
    ahead = (elbow[0] + 60 * math.cos(q[0]), elbow[1] - 60 * math.sin(q[0]))
    return [
        sketch.path([base, (base[0] + 90, base[1])], width=1.2, dash=sketch.DASHED),
        sketch.path([elbow, ahead], width=1.2, dash=sketch.DASHED),
        sketch.arc(base, 62.0, 0.0, first, arrow=True, kind="q1"),
        sketch.label((base[0] + 72, base[1] - 12), "q₁, τ₁", anchor="start"),
        sketch.arc(elbow, 44.0, first, second, arrow=True, kind="q2"),
        sketch.label((elbow[0] + 52, elbow[1] - 36), "q₂, τ₂", anchor="start"),
    ]


def _lengths(arm: TwoLinkArm, q: Sequence[float], at: View, lengths: Sequence[float]) -> list[str]:
    """The lengths of the links, beside their middles."""
    places = _points(arm, q, at)
    return [
        sketch.label(
            ((first[0] + last[0]) / 2 + 14, (first[1] + last[1]) / 2 - 4),
            f"l{sign} = {given(length, 'm')}",
            anchor="start",
        )
        for first, last, sign, length in zip(places[:-1], places[1:], "₁₂", lengths, strict=True)
    ]


def _points(arm: TwoLinkArm, q: Sequence[float], at: View) -> tuple[Point, Point, Point]:
    elbow, tip = arm.places(jnp.array(q))
    return at(0, 0), at(float(elbow[0]), float(elbow[1])), at(float(tip[0]), float(tip[1]))
