"""The style of all figures: colours that colour-blind readers can distinguish, one colour and marker per design."""

import html
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
INK, MUTED, GRID, LIMIT, ALARM, CLOUD = "#1b2733", "#5b6875", "#e4e8ec", "#33404d", "#8a1c5b", "#a9b4bf"
SIZE = 14
# Characters along a vertical axis, also of a figure in the size of a paper's column.
_LINE = 30
# Pixels above and below the plot of a figure, for labels and legends.
_GAP = 96

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
    styles: dict[str, Look] = {}
    for i, name in enumerate(names):
        known = KNOWN.get(name.split(",")[0].strip())
        styles[name] = known or Look(_COLOURS[i % len(_COLOURS)], _SYMBOLS[i % len(_SYMBOLS)])
    return styles


def plain(text: str) -> str:
    """Text escaped for plotly, which would read `<b>` as markup."""
    return html.escape(text, quote=False)


def label(name: str, unit: str = "") -> str:
    """An axis label with its unit."""
    return plain(f"{name} ({unit})" if unit not in ("", "-") else name)


def blank(x: str, y: str, *, title: str = "", height: int = 420) -> "Figure":
    """An empty figure in the house style, with axis labels `x` and `y` (markup escaped by `label`)."""
    from plotly.graph_objects import Figure

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
        "hoverformat": ".5~g",
    }
    above = {"text": title, "font": {"size": SIZE + 2}, "x": 0, "xref": "paper"}
    above |= {"y": 1, "yref": "container", "yanchor": "top", "pad": {"t": 10}, "automargin": True}
    layout = {
        # Only our own template: plotly's default one would add 7 kB to every figure of a page.
        "template": "none",
        "title": above if title else None,
        "font": {"family": FONT, "size": SIZE, "color": INK},
        "height": height,
        "autosize": True,
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 64, "r": 24, "t": 48 if title else 40, "b": 56},
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "font": {"size": SIZE - 1}} | legend_at(bool(title)),
        "hoverlabel": {"font": {"size": SIZE - 1, "family": FONT}, "bgcolor": "white", "align": "left"},
        "xaxis": axis | {"title": {"text": x, "standoff": 10}},
        "yaxis": axis | {"title": {"text": _in_lines(y), "standoff": 8}},
        "hovermode": "closest",
        "separators": ".\u202f",
    }
    # All at once: an update of a layout takes plotly twenty times as long.
    return Figure(layout=layout)


def legend_at(is_below: bool) -> dict[str, Any]:
    """The place of a legend: above the plot, or below it, where its rows do not reach into a title."""
    below, above = {"y": 0, "yref": "container", "yanchor": "bottom"}, {"y": 1.02, "yref": "paper", "yanchor": "bottom"}
    return below if is_below else above


def stacked(figures: "Sequence[Figure]") -> "Figure":
    """Figures below one another as one, each with its axes and its legend, under the title of the first.

    Those with the same label along the horizontal axis are zoomed together.
    """
    from plotly.subplots import make_subplots

    if len(figures) == 1:
        return figures[0]
    layouts: list[Any] = [one.layout for one in figures]
    first, heights = layouts[0], [one.height - _GAP for one in layouts]
    height = sum(one.height for one in layouts)
    whole: Any = make_subplots(len(figures), 1, row_heights=heights, vertical_spacing=_GAP / (height - _GAP))
    whole.update_layout(blank("", "", title=first.title.text or "", height=height).layout)
    for row, (figure, layout) in enumerate(zip(figures, layouts, strict=True), start=1):
        place, traces = {"row": row, "col": 1}, list[Any](figure.data)
        alike = row > 1 and layout.xaxis.title.text == first.xaxis.title.text
        whole.update_xaxes(layout.xaxis, matches="x" if alike else None, **place)
        whole.update_yaxes(layout.yaxis, **place)
        top, legend = next(whole.select_yaxes(**place)).domain[1], f"legend{row if row > 1 else ''}"
        whole.layout[legend] = layout.legend.to_plotly_json() | legend_at(is_below=False) | {"y": top + 0.01}
        whole.add_traces([trace.update(legend=legend) for trace in traces], row, 1)
        for shape in layout.shapes:
            whole.add_shape(shape, **place)
        for note in layout.annotations:
            whole.add_annotation(note, **place)
    return whole


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


def draw(
    figure: "Figure",
    x: Any,
    y: Any,
    look: Look | str,
    *,
    name: str = "",
    mode: str = "lines+markers",
    hover: str | None = "",
    **style: Any,
) -> None:
    """A curve, its markers or both, in the house style. Over a point stand its name and its numbers, by the axes.

    - `look`: its look, or its colour alone; `hover`: a further line over a point, with Plotly's placeholders; None for
      nothing at all;
    - `style`: further properties of Plotly's scatter traces, such as `line_dash`, which precede those of the house.
    """
    known = look if isinstance(look, Look) else Look(look, "circle")
    usual = {"x": x, "y": y, "mode": mode, "name": plain(name)}
    if "lines" in mode:
        usual |= {"line_color": known.colour, "line_width": 2}
    if "markers" in mode:
        usual |= {"marker_color": known.colour, "marker_symbol": known.symbol, "marker_size": 9}
    if hover is None:
        usual |= {"hoverinfo": "skip"}
    else:
        layout: Any = figure.layout
        labels = {"x": layout.xaxis.title.text, "y": layout.yaxis.title.text}
        numbers = [f"%{{{axis}axis.title.text}}: %{{{axis}}}" for axis, text in labels.items() if text]
        lines = "<br>".join(filter(None, [name and "<b>%{fullData.name}</b>", *numbers, hover]))
        usual |= {"hovertemplate": f"{lines}<extra></extra>"}
    figure.add_scatter(**(usual | style))


def add_band(figure: "Figure", times: np.ndarray, low: np.ndarray, high: np.ndarray, fill: str) -> None:
    """A filled band between two curves over time."""
    around, edges = np.concatenate([times, times[::-1]]), np.concatenate([high, low[::-1]])
    filled = {"fill": "toself", "fillcolor": fill, "line_width": 0, "showlegend": False}
    draw(figure, short(around), short(edges), fill, mode="lines", hover=None, **filled)


def limit_line(figure: "Figure", value: float, text: str, *, axis: str = "y", dash: str = "dash") -> None:
    """A limit as a line across the whole figure, with its name at its end, inside the plot.

    The name of a vertical limit is written along it; that of a horizontal one above it, or under a negative one.
    """
    # As by `add_hline` and `add_vline`, which take plotly a hundred times as long.
    across = "x" if axis == "y" else "y"
    ends = {f"{across}ref": f"{across} domain", f"{across}0": 0, f"{across}1": 1, f"{axis}0": value, f"{axis}1": value}
    figure.add_shape(type="line", line={"color": LIMIT, "width": 1.3, "dash": dash}, **ends)
    place: dict[str, Any] = {"x": 1, "xanchor": "right", "yanchor": "top" if value < 0 else "bottom"}
    if axis == "x":
        # Above the foot of a density, which is low at its limits.
        place = {"y": 0.3, "xanchor": "right", "yanchor": "bottom", "textangle": -90}
    # On a logarithmic axis Plotly places texts by exponents, but lines by values.
    layout: Any = figure.layout
    at = float(np.log10(value)) if layout[f"{axis}axis"].type == "log" else value
    place |= {axis: at, f"{across}ref": f"{across} domain", "showarrow": False, "bgcolor": "rgba(255,255,255,0.8)"}
    figure.add_annotation(text=plain(text), font={"size": SIZE - 1, "color": LIMIT}, **place)
