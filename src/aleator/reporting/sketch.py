"""Schematic drawings as SVG: lines, bodies, angles and dimensions as text, in the page's own colour.

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


def circle(centre: Point, radius: float, *, kind: str = "", filled: bool = False) -> str:
    """A circle; a `filled` one is a joint or a point mass."""
    ink = INK.replace('fill="none"', 'fill="currentColor"') if filled else INK
    place = f'cx="{_text(centre[0])}" cy="{_text(centre[1])}" r="{_text(radius)}"'
    return f"<circle {place} {ink}{_look(kind, 2.0, '')}/>"


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


def dimension(start: Point, end: Point, text: str, *, beside: Point, kind: str = "") -> str:
    """A dimension between two points: a line with two arrowheads, and its length `beside` it."""
    return arrow(start, end, kind=kind, both=True) + label(beside, text)


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
