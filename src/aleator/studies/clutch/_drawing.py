"""A quarter of the clutch, drawn to scale."""

import math
from collections.abc import Mapping

import numpy as np

from aleator.reporting import sketch
from aleator.reporting.sketch import View
from aleator.studies.clutch import MEANS, pressure_angle

WIDTH, HEIGHT = 420.0, 372.0
ACROSS = 320.0
"""Pixels from the middle of the ring to the ring."""


def clutch_drawing(dimensions: Mapping[str, float] = MEANS) -> str:
    """A quarter of the clutch as SVG: hub, roller and ring of the given dimensions (mm), and the angle that follows."""
    a, c, e = (dimensions[name] for name in ("a", "c", "e"))
    chi = float(pressure_angle(*np.array([a, c, e])))
    turn = math.radians(chi)
    b = (e - c) * math.sin(turn)
    at = View((56.0, 345.0), ACROSS / e)
    middle, contact = at(b, a + c), at(e * math.sin(turn), e * math.cos(turn))
    hub = [at(0, 0), at(0, a), at(0.6 * e, a), at(0.6 * e, 0)]
    slope = math.radians(32.0)
    parts = [
        sketch.arc(at(0, 0), at.scale * e, 0.0, 90.0, kind="ring", width=3.0),
        sketch.path(hub, kind="hub", closed=True),
        sketch.circle(middle, at.scale * c, kind="roller"),
        sketch.circle(at(0, 0), 3.0, filled=True),
        sketch.circle(middle, 3.0, filled=True),
        sketch.path([at(0, 0), contact], kind="line-of-centres", width=1.2),
        sketch.path([at(0, a), at(0, e)], width=1.2, dash=sketch.DASHED),
        sketch.path([at(b, a), at(b, a + 2.2 * c)], width=1.2, dash=sketch.DASHED),
    ]
    title = f"Quarter of a roller clutch: hub, roller and ring, with a pressure angle of {chi:.3f} degrees"
    return sketch.drawing(parts + _sizes(at, (a, b, c, e), chi, slope), width=WIDTH, height=HEIGHT, title=title)


def _sizes(at: View, sizes: tuple[float, float, float, float], chi: float, slope: float) -> list[str]:
    """Dimensions and angles."""
    a, b, c, e = sizes
    left, rim = at(-3.0, 0)[0], at(e * math.cos(slope), e * math.sin(slope))
    side = at(b + c, a + c)
    reach = 0.42 * e
    wedge = at(reach * math.sin(math.radians(chi) / 2), reach * math.cos(math.radians(chi) / 2))
    return [
        sketch.dimension((left, at(0, 0)[1]), (left, at(0, a)[1]), "a", beside=(left - 14, at(0, a / 2)[1]), kind="a"),
        sketch.dimension(at(0, a - 3.0), at(b, a - 3.0), "b", beside=at(b + 2.0, a - 4.0), kind="b"),
        sketch.arrow(at(b, a + c), side, kind="c"),
        sketch.label(at(b + c / 2, a + c + 1.2), "c"),
        sketch.arrow(at(0, 0), rim, kind="e"),
        sketch.label(at(0.9 * e * math.cos(slope + 0.09), 0.9 * e * math.sin(slope + 0.09)), "e"),
        sketch.arc(at(0, 0), at.scale * reach, 90.0, 90.0 - chi, kind="chi"),
        sketch.path([wedge, at(0.2 * e, 0.36 * e)], width=1.0),
        sketch.label(at(0.21 * e, 0.34 * e), f"χ = {chi:.3f}°", anchor="start"),
        sketch.arc(at(0, 0), at.scale * 0.2 * e, 0.0, 90.0 - chi, kind="gamma"),
        sketch.label(at(0.17 * e, 0.17 * e), "γ", anchor="start"),
        sketch.label(at(0.48 * e, 0.06 * e), "hub"),
        sketch.label(at(b + 1.15 * c, a + 0.35 * c), "roller", anchor="start"),
        sketch.label(at(0.75 * e, 0.75 * e), "ring", anchor="start"),
    ]
