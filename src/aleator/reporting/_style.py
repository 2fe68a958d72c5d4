"""The style of all figures: colours that colour-blind readers can distinguish, one colour and marker per design."""

import html
import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
INK, MUTED, GRID, LIMIT, ALARM = "#1b2733", "#5b6875", "#e4e8ec", "#33404d", "#8a1c5b"
SIZE = 14
# Characters along a vertical axis.
_LINE = 38

DASHES = ("solid", "dash", "dot", "dashdot")
"""Lines of boxes and limits that belong together."""

# Okabe and Ito (2008), without the yellow and the orange, which are too light for lines on white.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#a3508a", "#3f8fc4", "#5b5b5b")
_SYMBOLS = ("square", "circle", "diamond", "triangle-up", "pentagon", "hexagon")


@final
@dataclass(frozen=True)
class Look:
    """Colour and marker of one design, in every figure."""

    colour: str
    symbol: str

    def fill(self, opacity: float = 0.1) -> str:
        """The colour, translucent."""
        red, green, blue = (int(self.colour[i : i + 2], 16) for i in (1, 3, 5))
        return f"rgba({red},{green},{blue},{opacity})"


KNOWN = {"dOpt": Look("#d55e00", "circle"), "uOpt": Look("#0072b2", "square"), "aOpt": Look("#009e73", "diamond")}


def looks(names: Iterable[str]) -> dict[str, Look]:
    """A look for each design: that of the known design whose name begins it, or the next in the palette."""
    found: dict[str, Look] = {}
    for i, name in enumerate(names):
        known = KNOWN.get(name.split(",")[0].strip())
        found[name] = known or Look(_COLOURS[i % len(_COLOURS)], _SYMBOLS[i % len(_SYMBOLS)])
    return found


def plain(text: str) -> str:
    """Text escaped for plotly, which would read `<b>` as markup."""
    return html.escape(text, quote=False)


def label(name: str, unit: str = "") -> str:
    """An axis label with its unit."""
    return plain(f"{name} ({unit})" if unit not in ("", "-") else name)


def blank(x: str, y: str, *, title: str = "", height: int = 420) -> "Figure":
    """An empty figure in the house style, with axis labels `x` and `y` (markup escaped by `label`)."""
    from plotly.graph_objects import Figure

    figure = Figure()
    axis: dict[str, Any] = {
        "gridcolor": GRID,
        "linecolor": MUTED,
        "zeroline": False,
        "showline": True,
        "ticks": "outside",
        "tickcolor": MUTED,
        "ticklen": 4,
        "tickfont": {"size": SIZE - 1},
        "automargin": True,
        # Not "1µ" on an axis whose unit has a prefix of its own.
        "exponentformat": "power",
    }
    figure.update_layout(
        # Only our own template: plotly's default one would add 7 kB to every figure of a page.
        template="none",
        title={"text": title, "font": {"size": SIZE + 2}, "x": 0, "xref": "paper"} if title else None,
        font={"family": FONT, "size": SIZE, "color": INK},
        height=height,
        autosize=True,
        paper_bgcolor="white",
        plot_bgcolor="white",
        margin={"l": 64, "r": 24, "t": 40 if not title else 64, "b": 56},
        legend={
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "xanchor": "left",
            "yanchor": "bottom",
            "font": {"size": SIZE - 1},
        },
        hoverlabel={"font": {"size": SIZE - 1, "family": FONT}, "bgcolor": "white", "align": "left"},
        xaxis=axis | {"title": {"text": x, "standoff": 10}},
        yaxis=axis | {"title": {"text": _in_lines(y), "standoff": 8}},
        hovermode="closest",
        separators=".\u202f",
    )
    return figure


def _in_lines(text: str) -> str:
    """A label of a vertical axis in lines that are no longer than the axis."""
    if len(text) <= _LINE:
        return text
    # What is in parentheses at its end, its unit, stays together.
    text = re.sub(r"\([^()]*\)$", lambda unit: unit[0].replace(" ", "\u00a0"), text)
    return "<br>".join(textwrap.wrap(text, _LINE, break_long_words=False, break_on_hyphens=False))


def short(values: np.ndarray) -> np.ndarray:
    """Single precision: more than a screen shows, half the size on the page."""
    return np.asarray(values, dtype=np.float32)


def padded(values: Iterable[float], share: float = 0.07) -> list[float]:
    """A range with a margin around all values."""
    numbers = [float(value) for value in values]
    low, high = min(numbers, default=0.0), max(numbers, default=1.0)
    room = share * ((high - low) or abs(high) or 1.0)
    return [low - room, high + room]


def legend_entry(figure: "Figure", name: str, look: Look, *, line: bool = True) -> None:
    """A legend entry with the filled marker, whatever the first point's marker is."""
    figure.add_scatter(
        x=[None],
        y=[None],
        mode="lines+markers" if line else "markers",
        name=plain(name),
        legendgroup=plain(name),
        line={"color": look.colour, "width": 2},
        marker={"symbol": look.symbol, "size": 9, "color": look.colour},
        hoverinfo="skip",
    )


def add_band(figure: "Figure", times: np.ndarray, low: np.ndarray, high: np.ndarray, fill: str) -> None:
    """A filled band between two curves over time."""
    figure.add_scatter(
        x=short(np.concatenate([times, times[::-1]])),
        y=short(np.concatenate([high, low[::-1]])),
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=fill,
        showlegend=False,
        hoverinfo="skip",
    )


def limit_line(
    figure: "Figure",
    value: float,
    text: str,
    *,
    axis: str = "y",
    dash: str = "dash",
    upright: bool = False,
    under: bool = False,
    logarithmic: bool = False,
) -> None:
    """A limit as a line across the whole figure, with its name at its end, inside the plot.

    The name of a vertical limit is written along it, or `upright` beside its foot; that of a horizontal one above it,
    or `under` it. On a `logarithmic` axis Plotly places texts by exponents, but lines by values.
    """
    place_of_text = float(np.log10(value)) if logarithmic else value
    note = {
        "text": plain(text),
        "showarrow": False,
        "font": {"size": SIZE - 1, "color": LIMIT},
        "bgcolor": "rgba(255,255,255,0.8)",
    }
    line = {"color": LIMIT, "width": 1.3, "dash": dash}
    if axis == "y":
        figure.add_shape(type="line", xref="paper", x0=0, x1=1, y0=value, y1=value, line=line)
        anchor = "top" if under else "bottom"
        figure.add_annotation(xref="paper", x=1, xanchor="right", y=place_of_text, yanchor=anchor, **note)
    else:
        figure.add_shape(type="line", yref="paper", y0=0, y1=1, x0=value, x1=value, line=line)
        place = {"xanchor": "left"} if upright else {"xanchor": "right", "textangle": -90}
        # Above the foot of a density, which is low at its limits.
        height = 0.0 if upright else 0.3
        figure.add_annotation(yref="paper", y=height, yanchor="bottom", x=place_of_text, **place, **note)
