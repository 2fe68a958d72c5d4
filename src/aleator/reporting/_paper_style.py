"""Colours, markers and texts of Plotly, for Matplotlib."""

import html
import re

# Points of the font of a paper, and points for each pixel of a page.
FONT, POINTS = 8, 0.55
DASHES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
# Matplotlib's markers for those of the house style.
SYMBOLS = {
    "square": "s",
    "circle": "o",
    "diamond": "D",
    "triangle-up": "^",
    "pentagon": "p",
    "hexagon": "h",
    "star": "*",
    "x": "X",
    "x-thin": "x",
    "line-ns": "|",
}


def drawn_text(text: str) -> str:
    """A text of Plotly, whose markup is that of a page, as plain text. A dollar sign would begin mathematics."""
    plain = re.sub(r"<br\s*/?>", "\n", text)
    return html.unescape(re.sub(r"</?(b|i|sub|sup|extra)>", "", plain)).replace("$", r"\$").replace("\u202f", "\u2009")


def rgba(text: str) -> tuple[float, ...]:
    """`rgba(0,114,178,0.25)`, `rgb(0,76,120)` or `#0072b2` as numbers from 0 to 1."""
    if text.startswith("#"):
        return tuple(int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    numbers = [float(one) for one in text[text.index("(") + 1 : -1].split(",")]
    return (*(one / 255 for one in numbers[:3]), *numbers[3:])


def colour(text: str | None) -> tuple[float, ...]:
    """A colour, black where none is given."""
    return rgba(text) if text else (0.0, 0.0, 0.0)
