"""Schematic drawings as SVG: lines, bodies, springs, dampers, angles and dimensions as text, in the page's own colour.

Every function returns the text of one element; points are in pixels of the drawing, `y` downwards. `View` converts a
model's metres or millimetres to these. A `kind` becomes the element's class, by which it can be found.
"""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

Point = tuple[float, float]

INK = 'stroke="currentColor" fill="none" stroke-linecap="round" stroke-linejoin="round"'
DASHED = "6 5"


@final
@dataclass(frozen=True)
class View:
    """The map from a model's coordinates, `y` upwards, to a drawing: the origin there, and pixels per unit."""

    origin: Point
    scale: float

    def __call__(self, x: float, y: float) -> Point:
        """A point of the model in the drawing."""
        return self.origin[0] + self.scale * float(x), self.origin[1] - self.scale * float(y)


def drawing(elements: Sequence[str], *, width: float, height: float, title: str) -> str:
    """A complete drawing that scales with the page; `title` says in words what it shows."""
    said = html.escape(title)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_text(width)} {_text(height)}" role="img"'
        f' aria-label="{said}"><title>{said}</title>{"".join(elements)}</svg>'
    )


def path(points: Sequence[Point], *, kind: str = "", width: float = 2.0, dash: str = "", closed: bool = False) -> str:
    """A polyline through the points."""
    steps = " L ".join(f"{_text(x)} {_text(y)}" for x, y in points)
    return f'<path d="M {steps}{" Z" if closed else ""}" {INK}{_look(kind, width, dash)}/>'


def circle(centre: Point, radius: float, *, kind: str = "", width: float = 2.0, filled: bool = False) -> str:
    """A circle; a `filled` one is a joint or a point mass."""
    ink = INK.replace('fill="none"', 'fill="currentColor"') if filled else INK
    place = f'cx="{_text(centre[0])}" cy="{_text(centre[1])}" r="{_text(radius)}"'
    return f"<circle {place} {ink}{_look(kind, width, '')}/>"


def arc(
    centre: Point, radius: float, start: float, end: float, *, kind: str = "", width: float = 1.4, arrow: bool = False
) -> str:
    """An arc between two directions, in degrees counterclockwise from the right, with an `arrow` at its end."""
    count = max(2, math.ceil(abs(end - start) / 3) + 1)
    angles = [math.radians(start + (end - start) * i / (count - 1)) for i in range(count)]
    points = [(centre[0] + radius * math.cos(one), centre[1] - radius * math.sin(one)) for one in angles]
    return path(points, kind=kind, width=width) + (_head(points[-2], points[-1]) if arrow else "")


def label(place: Point, text: str, *, anchor: str = "middle", size: float = 15.0) -> str:
    """A text label; `anchor` is start, middle or end."""
    x, y = place
    return (
        f'<text x="{_text(x)}" y="{_text(y)}" text-anchor="{anchor}" font-size="{_text(size)}" fill="currentColor">'
        f"{html.escape(text)}</text>"
    )


def arrow(start: Point, end: Point, *, kind: str = "", both: bool = False) -> str:
    """A thin line with an arrowhead at its end, or at both."""
    return path([start, end], kind=kind, width=1.4) + _head(start, end) + (_head(end, start) if both else "")


def dimension(start: Point, end: Point, text: str, *, beside: Point, anchor: str = "middle", kind: str = "") -> str:
    """A dimension between two points: a line with two arrowheads, and its length `beside` it."""
    return arrow(start, end, kind=kind, both=True) + label(beside, text, anchor=anchor)


def spring(start: Point, end: Point, *, kind: str = "", coils: int = 5, half_width: float = 11.0) -> str:
    """A zigzag between two points, with straight ends."""
    ends = [0.15 + 0.7 * (i + 0.5) / (2 * coils) for i in range(2 * coils)]
    sides = [half_width * (-1) ** i for i in range(2 * coils)]
    bends = [_beside(start, end, share, side) for share, side in zip(ends, sides, strict=True)]
    return path([start, _beside(start, end, 0.15, 0), *bends, _beside(start, end, 0.85, 0), end], kind=kind)


def damper(start: Point, end: Point, *, kind: str = "", half_width: float = 12.0) -> str:
    """A piston in a cylinder between two points."""
    cup = [
        _beside(start, end, share, side)
        for share, side in ((0.68, -half_width), (0.35, -half_width), (0.35, half_width), (0.68, half_width))
    ]
    piston = [_beside(start, end, 0.52, side) for side in (0.8 * half_width, -0.8 * half_width)]
    rods = path([start, _beside(start, end, 0.35, 0)], kind=kind) + path([_beside(start, end, 0.52, 0), end])
    return rods + path(cup) + path(piston)


def ground(start: Point, end: Point, *, kind: str = "", spacing: float = 11.0) -> str:
    """The fixed ground: a line with hatching on its right, seen from start to end."""
    length = math.dist(start, end)
    count = max(1, int(length / spacing))
    strokes = []
    for i in range(count):
        share = (i + 0.5) / count
        strokes.append(path([_beside(start, end, share, 0), _beside(start, end, share - 7 / length, 8)], width=1.0))
    return path([start, end], kind=kind) + "".join(strokes)


def _beside(start: Point, end: Point, share: float, side: float) -> Point:
    """A point at the fraction `share` of the way, `side` pixels to its right in the drawing."""
    length = math.dist(start, end)
    along = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
    x, y = (start[i] + share * (end[i] - start[i]) for i in (0, 1))
    return x - side * along[1], y + side * along[0]


def _head(start: Point, end: Point) -> str:
    """The head of an arrow that ends at a point."""
    turn = math.atan2(end[1] - start[1], end[0] - start[0])
    wings = [(end[0] - 9 * math.cos(turn + side), end[1] - 9 * math.sin(turn + side)) for side in (0.35, -0.35)]
    return path([wings[0], end, wings[1]], width=1.4)


def _look(kind: str, width: float, dash: str) -> str:
    chosen = f' class="{html.escape(kind)}"' if kind else ""
    return f'{chosen} stroke-width="{_text(width)}"' + (f' stroke-dasharray="{dash}"' if dash else "")


def _text(value: float) -> str:
    """A coordinate to a hundredth of a pixel."""
    return f"{value:.2f}".rstrip("0").rstrip(".")
