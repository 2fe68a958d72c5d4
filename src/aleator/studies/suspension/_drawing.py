"""The quarter car on its road as a drawing, with the numbers of the model."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

import aleator as al
from aleator.reporting import given, sketch
from aleator.reporting.sketch import Point
from aleator.studies.suspension import QuarterCar

WIDTH, HEIGHT = 420.0, 410.0
MIDDLE = 165.0
AREA_PER_KG = 32.0
"""Pixels squared of a box for each kilogram."""

SYMBOLS = {"m_s": "mₛ", "m_u": "mᵤ", "k_s": "kₛ", "b_s": "bₛ", "eta": "η", "k_u": "kᵤ"}
BUMP = 40.0
"""Pixels from the road's lowest to its highest point."""

UNITS = {"m_s": "kg", "m_u": "kg", "k_s": "N/m", "b_s": "N s/m", "eta": "", "k_u": "N/m"}


def car_drawing(car: QuarterCar, times: Float[np.ndarray, " samples"], heights: Float[np.ndarray, " samples"]) -> str:
    """The car and its road (s, m) as SVG. An uncertain number is written with `(ξ)` and its half-width or spread.

    The masses are boxes with areas proportional to the masses; heights of the road are exaggerated.
    """
    sprung, unsprung = (_box(mass) for mass in (_mean(car.m_s), _mean(car.m_u)))
    top, wheel, contact = 70.0 + sprung[1], 250.0, 385.0
    under = wheel + unsprung[1]
    left, right = MIDDLE - 32.0, MIDDLE + 32.0
    parts = [
        *_body(MIDDLE, 70.0, sprung, "sprung"),
        *_body(MIDDLE, wheel, unsprung, "unsprung"),
        sketch.spring((left, top), (left, wheel), kind="suspension-spring"),
        sketch.damper((right, top), (right, wheel), kind="suspension-damper"),
        sketch.spring((MIDDLE, under), (MIDDLE, contact), kind="tyre-spring"),
        sketch.path(_road(times, heights, contact), kind="road"),
        sketch.circle((MIDDLE, contact), 3.5, filled=True),
        *_labels(car, (70.0 + sprung[1] / 2, (top + wheel) / 2, wheel + unsprung[1] / 2, (under + contact) / 2)),
        *(
            one
            for name, height in (("zₛ", 70.0 + sprung[1] / 2), ("zᵤ", wheel + unsprung[1] / 2), ("road", contact))
            for one in _place(name, height)
        ),
    ]
    title = "Quarter car: body on spring and damper, wheel on its tyre, over a road with bumps"
    return sketch.drawing(parts, width=WIDTH, height=HEIGHT, title=title)


def _box(mass: float) -> Point:
    """Width and height of the box of a mass, of one shape for all."""
    height = math.sqrt(mass * AREA_PER_KG / 3.0)
    return 3.0 * height, height


def _body(middle: float, top: float, size: Point, kind: str) -> list[str]:
    half = size[0] / 2
    corners = [
        (middle - half, top),
        (middle + half, top),
        (middle + half, top + size[1]),
        (middle - half, top + size[1]),
    ]
    return [sketch.path(corners, kind=kind, width=2.5, closed=True)]


def _labels(car: QuarterCar, rows: tuple[float, float, float, float]) -> list[str]:
    body, between, wheel, tyre = rows
    return [
        sketch.label((MIDDLE, body + 5), said(car, "m_s")),
        sketch.label((MIDDLE + 84, wheel + 5), said(car, "m_u"), anchor="start", size=13.0),
        sketch.label((MIDDLE - 52, between), SYMBOLS["k_s"], anchor="end"),
        sketch.label((MIDDLE + 54, between - 22), said(car, "k_s"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 54, between + 2), said(car, "b_s"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 54, between + 26), said(car, "eta"), anchor="start", size=13.0),
        sketch.label((MIDDLE + 24, tyre + 5), said(car, "k_u"), anchor="start", size=13.0),
    ]


def _place(name: str, height: float) -> list[str]:
    """The upward displacement of a body or the ground."""
    return [
        sketch.path([(14.0, height), (34.0, height)], width=1.2),
        sketch.arrow((24.0, height), (24.0, height - 36.0)),
        sketch.label((24.0, height - 43.0), name),
    ]


def said(car: QuarterCar, name: str) -> str:
    """A number of the car: `mᵤ = 94 kg`, `mₛ(ξ) = 376 ± 47 kg`; what is chosen is `kₛ⁰`, `kₛ¹`."""
    value: Any = getattr(car, name)
    symbol, unit = SYMBOLS[name], UNITS[name]
    middle, half_width = _parameters(value)
    text = _written(middle, f"{symbol}⁰")
    if half_width is not None:
        symbol, text = f"{symbol}(ξ)", f"{text} ± {_written(half_width, f'{symbol}¹')}"
    return f"{symbol} = {text} {unit}".rstrip()


def _parameters(value: Any) -> tuple[Any, Any]:
    if isinstance(value, al.Uniform):
        return value.parameters["mean"], value.parameters["half_width"]
    return value, None


def _mean(value: Any) -> float:
    return float(_parameters(value)[0])


def _written(value: Any, chosen: str) -> str:
    """A number, or the symbol of one that is chosen."""
    return chosen if isinstance(value, al.Decision) else given(float(value))


def _road(times: Float[np.ndarray, " samples"], heights: Float[np.ndarray, " samples"], contact: float) -> list[Point]:
    """The road across the drawing, with the wheel on it."""
    across = np.linspace(44.0, WIDTH - 6.0, 181)
    shares = (across - across[0]) / (across[-1] - across[0])
    rows = np.interp(times[0] + shares * (times[-1] - times[0]), times, heights) * BUMP / np.ptp(heights)
    raised = contact - (rows - np.interp(MIDDLE, across, rows))
    return list(zip(map(float, across), map(float, raised), strict=True))
