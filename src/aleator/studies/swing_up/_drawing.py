"""The double pendulum as a drawing to scale: hanging at its start, upright at its target."""

import math

from aleator.reporting import given, sketch
from aleator.reporting.sketch import Point, View
from aleator.studies.swing_up import DoublePendulum

WIDTH, HEIGHT = 420.0, 470.0
REACH = 195.0
"""Pixels from the first joint to the tip of the straight pendulum."""

HANGING, SWINGING, UPRIGHT = (-math.pi, 0.0), (-2.2, 0.5), (0.0, 0.0)
"""Angles of both joints, rad; the one between only shows how they are measured."""


def pendulum_drawing(pendulum: DoublePendulum) -> str:
    """The pendulum (with numbers for its lengths) as SVG: its start and target dashed, a posture between them solid."""
    lengths = float(pendulum.length_1), float(pendulum.length_2)  # pyright: ignore[reportArgumentType]
    at = View((130.0, HEIGHT / 2), REACH / sum(lengths))
    base, elbow, tip = _points(lengths, SWINGING, at)
    hanging, upright = (_points(lengths, posture, at) for posture in (HANGING, UPRIGHT))
    first, second = (90.0 + math.degrees(one) for one in (SWINGING[0], sum(SWINGING)))
    ahead = (elbow[0] + 60 * math.cos(math.radians(first)), elbow[1] - 60 * math.sin(math.radians(first)))
    parts = [
        sketch.path(hanging, kind="hanging", dash=sketch.DASHED),
        sketch.path(upright, kind="upright", dash=sketch.DASHED),
        sketch.path([base, elbow, tip], kind="swinging", width=5.0),
        *(sketch.circle(place, 5.0, filled=True) for place in (base, elbow, hanging[1], upright[1])),
        sketch.ground((base[0] - 60, base[1] - 22), (base[0] - 60, base[1] + 22)),
        sketch.path([(base[0] - 60, base[1]), base], width=2.0),
        sketch.arc(base, 50.0, 90.0, first, kind="q1", arrow=True),
        sketch.path([elbow, ahead], width=1.2, dash=sketch.DASHED),
        sketch.arc(elbow, 48.0, first, second, kind="q2", arrow=True),
        sketch.label((base[0] + 54, base[1] - 22), "q₁, τ₁", anchor="start"),
        sketch.label((ahead[0] + 8, ahead[1] + 6), "q₂ (free)", anchor="start"),
        sketch.label((upright[2][0] + 14, upright[2][1] + 8), "target", anchor="start"),
        sketch.label((hanging[2][0] + 14, hanging[2][1]), "start", anchor="start"),
        sketch.label((hanging[1][0] - 12, (hanging[0][1] + hanging[1][1]) / 2 + 16), _length(1, lengths), anchor="end"),
        sketch.label((hanging[1][0] - 12, (hanging[1][1] + hanging[2][1]) / 2), _length(2, lengths), anchor="end"),
        sketch.label(((elbow[0] + tip[0]) / 2 + 14, (elbow[1] + tip[1]) / 2 - 14), "m₂(ξ)"),
        sketch.arrow((360.0, 60.0), (360.0, 120.0), kind="gravity"),
        sketch.label((372.0, 95.0), "g", anchor="start"),
    ]
    title = "Double pendulum driven at its first joint: hanging at the start, upright at the target"
    return sketch.drawing(parts, width=WIDTH, height=HEIGHT, title=title)


def _length(which: int, lengths: tuple[float, float]) -> str:
    return f"l{'₁₂'[which - 1]} = {given(lengths[which - 1], 'm')}"


def _points(lengths: tuple[float, float], q: tuple[float, float], at: View) -> tuple[Point, Point, Point]:
    """First joint, second joint and tip; `q1` is measured from upright, `q2` from the first link."""
    elbow = (-lengths[0] * math.sin(q[0]), lengths[0] * math.cos(q[0]))
    tip = (elbow[0] - lengths[1] * math.sin(sum(q)), elbow[1] + lengths[1] * math.cos(sum(q)))
    return at(0, 0), at(*elbow), at(*tip)
