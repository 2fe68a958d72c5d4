"""Figures for papers: a figure of Plotly, which is plain data, drawn once more by Matplotlib.

Every figure of this package is described once, by Plotly's traces in the house style. Here the kinds of traces, lines
and notes that these use are drawn by Matplotlib, with the same colours and markers; anything else is refused, so that
no figure loses a part without a word.
"""

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from aleator._core.errors import MissingExtraError, ProblemError
from aleator.reporting._paper_style import SYMBOLS, colour, drawn_text, rgba

if TYPE_CHECKING:
    import matplotlib.figure
    from plotly.graph_objects import Figure

# Pairs of axes, whose keywords come from Plotly's descriptions, unknown to a type checker.
Axes: TypeAlias = Any

# Inches: one column of a journal, and higher for what needs room.
_WIDTH, _HEIGHT, _LARGE = 3.5, 2.7, 3.5
# Points of a paper for each pixel of a page.
_POINTS = 0.55
_FONT = 8
_DASHES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
_STYLE = {
    "font.size": _FONT,
    "axes.labelsize": _FONT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": _FONT,
    "figure.titlesize": _FONT,
    "grid.linewidth": 0.4,
    "legend.fontsize": _FONT - 1,
    "legend.frameon": False,
    "xtick.labelsize": _FONT - 1,
    "ytick.labelsize": _FONT - 1,
}


def paper_figure(figure: "Figure") -> "matplotlib.figure.Figure":
    """A figure of this package as one of Matplotlib, a column wide: `savefig("name.pdf")` or `.svg` writes it.

    Raises `MissingExtraError` if Matplotlib is not installed, `ProblemError` for a figure with a part that has no form
    on paper, such as an animation.
    """
    kinds = {trace.type for trace in _traces(figure)}
    if len(figure.frames or ()) or not kinds <= {"scatter", "bar", "scatter3d", "parcoords"}:
        odd = "an animation" if len(figure.frames or ()) else ", ".join(sorted(kinds))
        raise ProblemError(f"A figure on paper: expected curves, points, bands and bars; received {odd}.")
    matplotlib = _matplotlib()
    with matplotlib.rc_context(_STYLE):
        large = bool(kinds & {"scatter3d", "parcoords"})
        paper = matplotlib.figure.Figure(figsize=(_WIDTH, _LARGE if large else _HEIGHT), layout="constrained")
        if "scatter3d" in kinds:
            _draw_space(paper, figure)
        elif "parcoords" in kinds:
            _draw_parallel(paper, figure)
        else:
            _draw_plane(paper, figure)
        if figure.layout.title.text:
            paper.suptitle(drawn_text(figure.layout.title.text), x=0.02, ha="left")
    return paper


def _traces(figure: "Figure") -> list[Any]:
    return list(figure.data)


def _matplotlib() -> Any:
    """The library, imported late. Raises `MissingExtraError` if it is not installed."""
    try:
        import matplotlib
        import matplotlib.figure
    except ImportError as error:
        raise MissingExtraError(
            "backend='matplotlib' needs Matplotlib, an optional library: python -m pip install 'aleator[paper]'. "
            "Figures of Plotly need nothing more."
        ) from error
    return matplotlib


def _draw_plane(paper: "matplotlib.figure.Figure", figure: "Figure") -> None:
    """Curves, points, bands and bars on one pair of axes, or on two of which one is above the other."""
    layout = figure.layout
    lower = paper.subplots()
    axes: dict[str, Axes] = {"y": lower, **_upper(paper, lower, figure)}
    places = _categories(figure)
    for name, axis in (("x", layout.xaxis), ("y", layout.yaxis)):
        _scale(lower, name, axis, places[name])
    bars = [trace for trace in _traces(figure) if trace.type == "bar"]
    for trace in _traces(figure):
        if trace.type == "bar":
            _draw_bars(lower, trace, bars.index(trace), len(bars), places["x"])
        else:
            _draw_curve(axes[trace.yaxis or "y"], trace, places)
    for shape in layout.shapes:
        _draw_shape(lower, shape)
    for note in layout.annotations:
        _draw_note(axes.get(note.yref or "y", lower), note, places)
    _fit(lower, layout)
    _add_legend(paper, lower, layout)


def _upper(paper: "matplotlib.figure.Figure", lower: Axes, figure: "Figure") -> dict[str, Axes]:
    """The second pair of axes above the first, without marks of its own, where a figure has one."""
    if not any(getattr(trace, "yaxis", None) == "y2" for trace in _traces(figure)):
        return {}
    second = figure.layout.yaxis2
    below, above = figure.layout.yaxis.domain, second.domain
    grid = paper.add_gridspec(2, 1, height_ratios=[above[1] - above[0], below[1] - below[0]])
    lower.set_subplotspec(grid[1])
    upper = paper.add_subplot(grid[0], sharex=lower)
    upper.set_axis_off()
    upper.set_ylim(*second.range)
    return {"y2": upper}


def _categories(figure: "Figure") -> dict[str, list[str]]:
    """The names along each axis that has names instead of numbers, in order."""
    found: dict[str, list[str]] = {}
    for name in ("x", "y"):
        axis = getattr(figure.layout, f"{name}axis")
        given = [] if axis.categoryarray is None else [str(one) for one in axis.categoryarray]
        met = [one for trace in _traces(figure) for one in _listed(getattr(trace, name)) if isinstance(one, str)]
        found[name] = list(dict.fromkeys([*given, *met]))
    return found


def _scale(axes: Axes, name: str, axis: Any, places: list[str]) -> None:
    """The label of an axis, its scale, its names and its grid."""
    getattr(axes, f"set_{name}label")(drawn_text(axis.title.text or ""))
    if axis.type == "log":
        getattr(axes, f"set_{name}scale")("log")
    if places:
        texts, crowded = [drawn_text(one) for one in places], sum(map(len, places)) > 40
        turned = {"rotation": 30, "ha": "right"} if name == "x" and crowded else {}
        getattr(axes, f"set_{name}ticks")(range(len(places)), texts, **turned)
    if axis.showgrid is not False:
        axes.grid(visible=True, axis=name, color=colour(axis.gridcolor), zorder=0)
    axes.set_axisbelow(True)


def _fit(axes: Axes, layout: Any) -> None:
    """The ranges of both axes, once everything is drawn."""
    for name, axis in (("x", layout.xaxis), ("y", layout.yaxis)):
        bounds = None if axis.range is None else [10.0**one if axis.type == "log" else one for one in axis.range]
        if bounds is not None:
            getattr(axes, f"set_{name}lim")(*bounds)
        elif axis.rangemode == "tozero":
            low, high = getattr(axes, f"get_{name}lim")()
            getattr(axes, f"set_{name}lim")(min(low, 0.0) if low < 0 and _reaches_below(axes) else 0.0, high)


def _reaches_below(axes: Axes) -> bool:
    return bool(axes.dataLim.y0 < 0)


def _draw_curve(axes: Axes, trace: Any, places: Mapping[str, list[str]]) -> None:
    """A line, its markers, the area under or within it, its texts and its error bars."""
    x, y = (_numbers(getattr(trace, name), places[name]) for name in ("x", "y"))
    if trace.fill in ("toself", "tozeroy"):
        (axes.fill if trace.fill == "toself" else axes.fill_between)(x, y, color=rgba(trace.fillcolor), lw=0, zorder=2)
        return
    mode, line, marker = trace.mode or "lines", trace.line, trace.marker
    opacity = 1.0 if trace.opacity is None else trace.opacity
    named = {"label": drawn_text(trace.name or "")} if trace.showlegend is not False and trace.name else {}
    steps = {"drawstyle": "steps-post"} if line.shape == "hv" else {}
    solid = {"color": colour(line.color), "lw": _POINTS * (line.width or 2), "ls": _DASHES[line.dash or "solid"]}
    symbols = _each(marker.symbol or "circle", len(x))
    one_symbol = SYMBOLS[symbols[0].removesuffix("-open")] if len(set(symbols)) <= 1 and len(symbols) else None
    if "lines" in mode:
        marked = _marks(marker, symbols[0]) if "markers" in mode and one_symbol else {}
        axes.plot(x, y, **solid, **steps, **marked, **named, alpha=opacity, zorder=3)
    if "markers" in mode and not ("lines" in mode and one_symbol):
        _draw_points(axes, x, y, marker, symbols, {} if "lines" in mode else named)
    if trace.error_y.array is not None:
        reach = np.array([_numbers(trace.error_y.arrayminus, []), _numbers(trace.error_y.array, [])])
        axes.errorbar(x, y, yerr=reach, fmt="none", ecolor=colour(trace.error_y.color), lw=0.8, capsize=2, zorder=3)
    if "text" in mode:
        _draw_texts(axes, x, y, trace)


def _marks(marker: Any, symbol: str) -> dict[str, Any]:
    """Markers along a line."""
    shade = colour(marker.color)
    return {
        "marker": SYMBOLS[symbol.removesuffix("-open")],
        "markersize": _POINTS * (marker.size or 6),
        "markerfacecolor": "white" if symbol.endswith("-open") else shade,
        "markeredgecolor": shade,
    }


def _draw_points(
    axes: Axes, x: np.ndarray, y: np.ndarray, marker: Any, symbols: list[str], named: Mapping[str, str]
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
            **(named if i == 0 else {}),
        )


def _draw_texts(axes: Axes, x: np.ndarray, y: np.ndarray, trace: Any) -> None:
    place = trace.textposition or "middle center"
    side = {"left": "right", "right": "left"}.get(place.split()[-1], "center")
    height = {"top": "bottom", "bottom": "top"}.get(place.split()[0], "center")
    texts = _each(trace.text or "", len(x))
    for at, up, text in zip(x, y, texts, strict=True):
        if text:
            shade = colour(trace.textfont.color or "#1b2733")
            axes.annotate(drawn_text(text), (at, up), ha=side, va=height, color=shade, fontsize=_FONT - 1)


def _draw_bars(axes: Axes, trace: Any, which: int, count: int, places: list[str]) -> None:
    width = 0.65 / count
    at = _numbers(trace.x, places) + (which - (count - 1) / 2) * width
    named = {"label": drawn_text(trace.name)} if trace.name else {}
    drawn = axes.bar(at, _numbers(trace.y, []), width, color=colour(trace.marker.color), zorder=2, **named)
    if trace.text is not None:
        axes.bar_label(drawn, [drawn_text(one) for one in trace.text], fontsize=_FONT - 2, padding=1)


def _draw_shape(axes: Axes, shape: Any) -> None:
    """A limit across the figure, or a shaded part of an axis."""
    if shape.type == "line":
        style = {"color": colour(shape.line.color), "lw": _POINTS * 1.6, "ls": _DASHES[shape.line.dash or "solid"]}
        axes.axhline(shape.y0, **style) if shape.xref == "paper" else axes.axvline(shape.x0, **style)
    elif shape.type == "rect" and shape.yref in ("paper", "y domain"):
        axes.axvspan(shape.x0, shape.x1, color=colour(shape.fillcolor), alpha=shape.opacity, lw=0, zorder=1)
    else:
        raise ProblemError(f"A figure on paper: expected lines across it and shaded ranges; received a {shape.type}.")


def _draw_note(axes: Axes, note: Any, places: Mapping[str, list[str]]) -> None:
    """A text at a place in the data, or along the edge of the figure."""
    across, up = (note.xref or "x").split()[0] == "paper", (note.yref or "y").split()[0] == "paper"
    blended: Callable[..., Any] = functools.partial(axes.annotate, annotation_clip=False)
    frame = (("axes fraction" if across else "data"), ("axes fraction" if up else "data"))
    at = tuple(
        float(one) if is_share or not isinstance(one, str) else places[name].index(one)
        for name, one, is_share in (("x", note.x, across), ("y", note.y, up))
    )
    turned = -(note.textangle or 0)
    side = "right" if turned else {"left": "left", "right": "right"}.get(note.xanchor, "center")
    blended(
        drawn_text(note.text),
        at,
        xycoords=frame,
        xytext=(-1 if turned else _POINTS * (note.xshift or 0), 1),
        textcoords="offset points",
        ha=side,
        va={"top": "top", "bottom": "bottom"}.get(note.yanchor, "center"),
        rotation=turned,
        color=colour(note.font.color or "#1b2733"),
        fontsize=_FONT - 1,
        zorder=5,
    )


def _add_legend(paper: "matplotlib.figure.Figure", axes: Axes, layout: Any) -> None:
    """The legend above the axes; each name once."""
    handles, names = axes.get_legend_handles_labels()
    each = dict(zip(reversed(names), reversed(handles), strict=True))
    names = list(dict.fromkeys(names))
    if layout.showlegend is False or not names or (len(names) == 1 and layout.showlegend is None):
        return
    columns = 1 if max(map(len, names)) > 28 else 2
    paper.legend([each[one] for one in names], names, loc="outside upper left", ncols=columns)


def _draw_space(paper: "matplotlib.figure.Figure", figure: "Figure") -> None:
    axes: Any = paper.add_subplot(projection="3d")
    trace: Any = figure.data[0]
    scene = figure.layout.scene
    axes.scatter(
        *(_numbers(getattr(trace, one), []) for one in "xyz"),
        c=_numbers(trace.marker.color, []),
        cmap="cividis",
        s=14,
        edgecolors="#1b2733",
        linewidths=0.3,
        depthshade=False,
    )
    for one in "xyz":
        getattr(axes, f"set_{one}label")(drawn_text(getattr(scene, f"{one}axis").title.text))
    # As seen from the camera of the page.
    axes.view_init(elev=22, azim=45)
    axes.set_box_aspect(None, zoom=0.78)


def _draw_parallel(paper: "matplotlib.figure.Figure", figure: "Figure") -> None:
    """One axis for each dimension, from its least to its largest value."""
    import matplotlib

    axes = paper.subplots()
    trace: Any = figure.data[0]
    columns = [np.asarray(one["values"], dtype=float) for one in trace.dimensions]
    ends = [(one.min(), one.max()) for one in columns]
    heights = np.array([(one - low) / ((high - low) or 1.0) for one, (low, high) in zip(columns, ends, strict=True)])
    shades = np.asarray(trace.line.color, dtype=float)
    ways = (shades - shades.min()) / ((shades.max() - shades.min()) or 1.0)
    for row, way in zip(heights.T, ways, strict=True):
        axes.plot(range(len(columns)), row, color=matplotlib.colormaps["cividis"](way), lw=0.9)
    for i, (low, high) in enumerate(ends):
        axes.axvline(i, color="#33404d", lw=0.8)
        for value, height, where in ((low, -0.03, "top"), (high, 1.03, "bottom")):
            axes.annotate(f"{value:.4g}", (i, height), ha="center", va=where, fontsize=_FONT - 1)
    axes.set_xticks(range(len(columns)), [drawn_text(one["label"]).replace(" (", "\n(") for one in trace.dimensions])
    axes.set_ylim(-0.12, 1.12)
    axes.tick_params(length=0)
    axes.yaxis.set_visible(False)
    for side in axes.spines.values():
        side.set_visible(False)


def _listed(values: Any) -> list[Any]:
    return [] if values is None else list(values)


def _numbers(values: Any, places: list[str]) -> np.ndarray:
    """Coordinates as numbers: names by their places along the axis, gaps as NaN."""
    placed = [places.index(one) if isinstance(one, str) else one for one in _listed(values)]
    return np.array([np.nan if one is None else float(one) for one in placed])


def _each(value: Any, count: int) -> list[Any]:
    """One value for each of some points."""
    return [value] * count if isinstance(value, str) else list(value)
