"""Figures for papers: a figure of Plotly, which is plain data, drawn once more by Matplotlib.

Every figure of this package is described once, by Plotly's traces in the house style. Here the kinds of traces, lines
and notes that these use are drawn by Matplotlib, with the same colours and markers; anything else is refused, so that
no figure loses a part without a word.
"""

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator._core.errors import MissingExtraError, ProblemError
from aleator.reporting._paper_marks import (
    FONT,
    Axes,
    colour,
    draw_bars,
    draw_curve,
    draw_note,
    draw_shape,
    drawn_text,
    listed,
    numbers,
)

if TYPE_CHECKING:
    import matplotlib.figure
    from plotly.graph_objects import Figure

# Inches: one column of a journal, and higher for what needs room.
_WIDTH, _HEIGHT, _LARGE = 3.5, 2.7, 3.5
# Characters of a name along an axis, in one line.
_NAME = 26
_STYLE = {
    "font.size": FONT,
    "axes.labelsize": FONT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": FONT,
    "figure.titlesize": FONT,
    "grid.linewidth": 0.4,
    "legend.fontsize": FONT - 1,
    "legend.frameon": False,
    "xtick.labelsize": FONT - 1,
    "ytick.labelsize": FONT - 1,
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
        large = bool(kinds & {"scatter3d", "parcoords"}) or figure.layout.yaxis.scaleanchor == "x"
        paper = matplotlib.figure.Figure(figsize=(_WIDTH, _LARGE if large else _HEIGHT), layout="constrained")
        if "scatter3d" in kinds:
            _draw_space(paper, figure)
        elif "parcoords" in kinds:
            _draw_parallel(paper, figure)
        else:
            _draw_plane(paper, figure)
        if figure.layout.title.text:
            paper.axes[0].set_title(drawn_text(figure.layout.title.text), loc="left")
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
            draw_bars(lower, trace, bars.index(trace), len(bars), places["x"])
        else:
            draw_curve(axes[trace.yaxis or "y"], trace, places)
    for shape in layout.shapes:
        draw_shape(lower, shape)
    for note in layout.annotations:
        draw_note(axes.get(note.yref or "y", lower), note, places, figure.layout)
    _fit(lower, layout)
    if layout.yaxis.scaleanchor == "x":
        lower.set_aspect("equal")
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
        met = [one for trace in _traces(figure) for one in listed(getattr(trace, name)) if isinstance(one, str)]
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
        getattr(axes, f"set_{name}ticks")(range(len(places)), [textwrap.fill(one, _NAME) for one in texts], **turned)
        getattr(axes, f"set_{name}lim")(-0.5, len(places) - 0.5)
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
            getattr(axes, f"set_{name}lim")(min(low, 0.0) if low < 0 and axes.dataLim.y0 < 0 else 0.0, high)


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
    """Points in space, each on a stem, without which nobody sees where it stands."""
    axes: Any = paper.add_subplot(projection="3d")
    trace: Any = figure.data[0]
    scene = figure.layout.scene
    x, y, z = (numbers(getattr(trace, one), []) for one in "xyz")
    floor = float(z.min() - 0.08 * np.ptp(z))
    for i in range(len(x)):
        axes.plot([x[i], x[i]], [y[i], y[i]], [floor, z[i]], color="#a9b4bf", lw=0.6)
    axes.set_zlim(bottom=floor)
    axes.locator_params(nbins=4)
    axes.scatter(
        x,
        y,
        z,
        c=numbers(trace.marker.color, []),
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
    axes.set_box_aspect(None, zoom=0.8)


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
            axes.annotate(f"{value:.4g}", (i, height), ha="center", va=where, fontsize=FONT - 1)
    axes.set_xticks(range(len(columns)), [drawn_text(one["label"]).replace(" (", "\n(") for one in trace.dimensions])
    axes.set_ylim(-0.12, 1.12)
    axes.tick_params(length=0)
    axes.yaxis.set_visible(False)
    for side in axes.spines.values():
        side.set_visible(False)
