"""The linkage, drawn to scale."""

from collections.abc import Mapping

import numpy as np

from aleator.reporting import sketch
from aleator.reporting.sketch import Point, View
from aleator.studies.four_bar import ANGLES, LENGTHS
from aleator.studies.four_bar._elimination import crank_angles, posture_of

_WIDTH, _HEIGHT = 460.0, 400.0
SHOWN = 2.3
"""The crank's angle in the drawing, rad."""


def linkage_drawing(lengths: Mapping[str, float] = LENGTHS) -> str:
    """The linkage of some lengths (mm) as SVG, its tool's path dashed."""
    at = View((150.0, 350.0), 0.62)
    now, path = posture_of(lengths, np.array(SHOWN)), posture_of(lengths, crank_angles()).tool
    bearing, support = at(0, 0), at(lengths["ground"], 0)
    pin, end, tool = (_point(at, one) for one in (now.crank_pin, now.rocker_pin, now.tool))
    parts = [
        sketch.path([_point(at, one) for one in path], kind="line", width=1.4, dash=sketch.DASHED),
        sketch.path([bearing, pin], kind="crank", width=5.0),
        sketch.path([pin, end, tool], kind="coupler", width=5.0),
        sketch.path([support, end], kind="rocker", width=5.0),
        *(sketch.circle(one, 5.0, filled=True) for one in (bearing, support, pin, end)),
        sketch.circle(tool, 10.0, kind="tool"),
        *(sketch.ground((x + 18, y + 14), (x - 18, y + 14)) for x, y in (bearing, support)),
        sketch.arc(bearing, 30.0, 0.0, float(np.rad2deg(SHOWN)), arrow=True, kind="angle"),
        sketch.label((bearing[0] + 44, bearing[1] - 12), "θ, τ", anchor="start"),
        sketch.label(_between(bearing, pin, -16), "crank", anchor="end"),
        sketch.label(_between(pin, end, -12), "coupler", anchor="end"),
        sketch.label(_between(support, end, 12), "rocker", anchor="start"),
        sketch.label((tool[0], tool[1] - 18), "tool"),
    ]
    ends = " to ".join(f"{np.rad2deg(one):.0f}°" for one in ANGLES)
    title = f"Four-bar linkage whose tool follows an almost straight line while the crank swings from {ends}"
    return sketch.drawing(parts, width=_WIDTH, height=_HEIGHT, title=title)


def _point(at: View, place: np.ndarray) -> Point:
    return at(float(place[0]), float(place[1]))


def _between(start: Point, end: Point, aside: float) -> Point:
    return (start[0] + end[0]) / 2 + aside, (start[1] + end[1]) / 2
