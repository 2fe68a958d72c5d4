"""What is on the axes of a figure for papers: traces, lines and notes of Plotly, drawn by Matplotlib."""

import html
import re
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from aleator._core.errors import ProblemError

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


# Pairs of axes, whose keywords come from Plotly's descriptions, unknown to a type checker.
Axes: TypeAlias = Any


def draw_curve(axes: Axes, trace: Any, places: Mapping[str, list[str]]) -> None:
    """A line, its markers, the area under or within it, its texts and its error bars."""
    x, y = (numbers(getattr(trace, name), places[name]) for name in ("x", "y"))
    if trace.fill in ("toself", "tozeroy"):
        fill = axes.fill if trace.fill == "toself" else axes.fill_between
        fill(x, y, color=rgba(trace.fillcolor), alpha=trace.opacity, lw=0, zorder=2)
        return
    mode, line, marker = trace.mode or "lines", trace.line, trace.marker
    opacity = 1.0 if trace.opacity is None else trace.opacity
    named = {"label": drawn_text(trace.name or "")} if trace.showlegend is not False and trace.name else {}
    steps = {"drawstyle": "steps-post"} if line.shape == "hv" else {}
    solid = {"color": colour(line.color), "lw": POINTS * (line.width or 2), "ls": DASHES[line.dash or "solid"]}
    clipped = {"clip_on": trace.cliponaxis is not False}
    symbols = _each(marker.symbol or "circle", len(x))
    one_symbol = SYMBOLS[symbols[0].removesuffix("-open")] if len(set(symbols)) <= 1 and len(symbols) else None
    if "lines" in mode:
        marked = _marks(marker, symbols[0]) if "markers" in mode and one_symbol else {}
        axes.plot(x, y, **solid, **steps, **marked, **named, **clipped, alpha=opacity, zorder=3)
    if "markers" in mode and not ("lines" in mode and one_symbol):
        _draw_points(axes, x, y, marker, symbols, clipped | ({} if "lines" in mode else named))
    if trace.error_y.array is not None:
        reach = np.array([numbers(trace.error_y.arrayminus, []), numbers(trace.error_y.array, [])])
        axes.errorbar(
            x, y, yerr=reach, fmt="none", ecolor=colour(trace.error_y.color), lw=0.8, capsize=2, zorder=3, **clipped
        )
    if "text" in mode:
        _draw_texts(axes, x, y, trace)


def _marks(marker: Any, symbol: str) -> dict[str, Any]:
    """Markers along a line."""
    shade = colour(marker.color)
    return {
        "marker": SYMBOLS[symbol.removesuffix("-open")],
        "markersize": POINTS * (marker.size or 6),
        "markerfacecolor": "white" if symbol.endswith("-open") else shade,
        "markeredgecolor": shade,
    }


def _draw_points(
    axes: Axes, x: np.ndarray, y: np.ndarray, marker: Any, symbols: list[str], options: Mapping[str, Any]
) -> None:
    """Markers without a line, or of several symbols: each symbol at its own points."""
    edge = marker.line.color if symbols and symbols[0] in ("x-thin", "line-ns") else marker.color
    for i, symbol in enumerate(dict.fromkeys(symbols)):
        chosen = np.array([one == symbol for one in symbols])
        shade = colour(edge)
        axes.plot(
            x[chosen],
            y[chosen],
            ls="none",
            alpha=1.0 if marker.opacity is None else marker.opacity,
            zorder=4,
            **(_marks(marker, symbol) | {"markeredgecolor": shade}),
            **{key: one for key, one in options.items() if i == 0 or key != "label"},
        )


def _draw_texts(axes: Axes, x: np.ndarray, y: np.ndarray, trace: Any) -> None:
    place = trace.textposition or "middle center"
    side = {"left": "right", "right": "left"}.get(place.split()[-1], "center")
    height = {"top": "bottom", "bottom": "top"}.get(place.split()[0], "center")
    texts = _each(trace.text or "", len(x))
    for at, up, text in zip(x, y, texts, strict=True):
        if text:
            shade = colour(trace.textfont.color or "#1b2733")
            gap = {"left": 4, "right": -4}.get(side, 0), {"bottom": 2, "top": -2}.get(height, 0)
            where = {"xytext": gap, "textcoords": "offset points", "ha": side, "va": height}
            axes.annotate(drawn_text(text.strip()), (at, up), **where, color=shade, fontsize=FONT - 1)


def draw_bars(axes: Axes, trace: Any, which: int, count: int, places: list[str]) -> None:
    """Bars beside one another, one group for each trace, with their numbers."""
    width = 0.65 / count
    at = numbers(trace.x, places) + (which - (count - 1) / 2) * width
    named = {"label": drawn_text(trace.name)} if trace.name else {}
    drawn = axes.bar(at, numbers(trace.y, []), width, color=colour(trace.marker.color), zorder=2, **named)
    if trace.text is not None:
        axes.bar_label(drawn, [drawn_text(one) for one in trace.text], fontsize=FONT - 2, padding=1)


def draw_shape(axes: Axes, shape: Any) -> None:
    """A limit across the figure, a shaded part of an axis, or a shaded disc or rectangle in the plane."""
    if shape.type == "line":
        style = {"color": colour(shape.line.color), "lw": POINTS * 1.6, "ls": DASHES[shape.line.dash or "solid"]}
        axes.axhline(shape.y0, **style) if shape.xref == "paper" else axes.axvline(shape.x0, **style)
    elif shape.type == "rect" and shape.yref in ("paper", "y domain"):
        axes.axvspan(shape.x0, shape.x1, color=colour(shape.fillcolor), alpha=shape.opacity, lw=0, zorder=1)
    elif shape.type in ("circle", "rect") and (shape.xref or "x", shape.yref or "y") == ("x", "y"):
        _draw_solid(axes, shape)
    else:
        raise ProblemError(
            f"A figure on paper: expected lines across it, shaded ranges, discs, rectangles; received a {shape.type}."
        )


def _draw_solid(axes: Axes, shape: Any) -> None:
    """A disc or a rectangle between two corners."""
    from matplotlib.patches import Ellipse, Rectangle

    corner, size = (shape.x0, shape.y0), (shape.x1 - shape.x0, shape.y1 - shape.y0)
    middle = (shape.x0 + shape.x1) / 2, (shape.y0 + shape.y1) / 2
    kind, place = (Ellipse, middle) if shape.type == "circle" else (Rectangle, corner)
    width = 1.0 if shape.line.width is None else shape.line.width
    edge = {"ec": colour(shape.line.color), "lw": POINTS * width}
    axes.add_patch(kind(place, *size, fc=colour(shape.fillcolor), zorder=1, **edge))


def _place(at: Any, places: list[str], axis: Any, is_share: bool) -> float:
    """Where a text stands along an axis: at a share of it, at a name, or at a number."""
    if isinstance(at, str):
        return places.index(at)
    # Plotly places texts on a logarithmic axis by exponents.
    return 10.0**at if axis.type == "log" and not is_share else float(at)


def draw_note(axes: Axes, note: Any, places: Mapping[str, list[str]], layout: Any) -> None:
    """A text at a place in the data, or along the edge of the figure."""
    across, up = (note.xref or "x").split()[0] == "paper", (note.yref or "y").split()[0] == "paper"
    frame = (("axes fraction" if across else "data"), ("axes fraction" if up else "data"))
    at = _place(note.x, places["x"], layout.xaxis, across), _place(note.y, places["y"], layout.yaxis, up)
    turned, height = -(note.textangle or 0), {"top": "top", "bottom": "bottom"}.get(note.yanchor, "center")
    away = {"top": -1, "bottom": 1, "center": 0}[height] + POINTS * (note.yshift or 0)
    side = {"left": "left", "right": "right"}.get(note.xanchor, "center")
    axes.annotate(
        drawn_text(note.text),
        at,
        xycoords=frame,
        xytext=(-2 if turned and side == "right" else POINTS * (note.xshift or 0), away),
        textcoords="offset points",
        ha=side,
        va=height,
        rotation=turned,
        color=colour(note.font.color or "#1b2733"),
        fontsize=FONT - 1,
        zorder=5,
        annotation_clip=False,
        bbox={"boxstyle": "square,pad=0.1", "fc": "white", "alpha": 0.8, "lw": 0} if note.bgcolor else None,
    )


def listed(values: Any) -> list[Any]:
    """The entries of a coordinate of a trace."""
    return [] if values is None else list(values)


def numbers(values: Any, places: list[str]) -> np.ndarray:
    """Coordinates as numbers: names by their places along the axis, gaps as NaN."""
    placed = [places.index(one) if isinstance(one, str) else one for one in listed(values)]
    return np.array([np.nan if one is None else float(one) for one in placed])


def _each(value: Any, count: int) -> list[Any]:
    """One value for each of some points."""
    return [value] * count if isinstance(value, str) else list(value)
