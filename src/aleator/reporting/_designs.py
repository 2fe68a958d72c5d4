"""Figures of designs: decisions between their bounds, boxes of mean ± sigma in the space of requirements; and of how
a design came about: what a search evaluated, and the meshes of a simultaneous program.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

import numpy as np

from aleator._core.errors import ProblemError
from aleator.nlp import Searched
from aleator.reporting._blocks import Drawing
from aleator.reporting._numbers import count, given, number, residual, unit_of_decision, unit_of_objective
from aleator.reporting._style import (
    ALARM,
    DASHES,
    INK,
    LIMIT,
    MUTED,
    SIZE,
    Look,
    blank,
    label,
    limit_line,
    looks,
    padded,
    plain,
    short,
)
from aleator.solution import MeshError, Solution
from aleator.uncertainty import Decision

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


@final
@dataclass(frozen=True)
class Axis:
    """One requirement: its name and unit, and its limits by their labels."""

    name: str
    unit: str = ""
    limits: Mapping[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Box:
    """A design among requirements: the centre and the half-widths of its box, by the requirement's key.

    `design` determines its look and its legend entry; `dash` its line style.
    """

    design: str
    centre: Mapping[str, float]
    half: Mapping[str, float]
    dash: str = "solid"
    note: str = ""


def projection_figure(
    boxes: Sequence[Box], across: str, up: str, axes: Mapping[str, Axis], *, height: int = 420
) -> "Figure":
    """Designs projected on the plane of two requirements (figures 6.6, 6.7 and 7.2)."""
    figure = blank(label(axes[across].name, axes[across].unit), label(axes[up].name, axes[up].unit), height=height)
    seen: set[str] = set()
    styles = looks(dict.fromkeys(box.design for box in boxes))
    # All boxes first, so that none covers a point.
    for box in boxes:
        _add_box(figure, box, (across, up), styles[box.design])
    for box in boxes:
        look, name = styles[box.design], plain(box.design)
        figure.add_scatter(
            x=[box.centre[across]],
            y=[box.centre[up]],
            mode="markers",
            name=name,
            legendgroup=name,
            showlegend=box.design not in seen,
            marker={"symbol": look.symbol, "size": 11, "color": look.colour, "line": {"color": "white", "width": 1}},
            hovertemplate=_hover(box, (across, up), axes),
        )
        seen.add(box.design)
    for key, axis in ((across, "x"), (up, "y")):
        for i, (text, value) in enumerate(axes[key].limits.items()):
            limit_line(
                figure, value, text, axis=axis, dash=DASHES[i % len(DASHES)] if len(axes[key].limits) > 1 else "dash"
            )
    figure.update_xaxes(range=_reach(boxes, across, axes))
    figure.update_yaxes(range=_reach(boxes, up, axes))
    return figure


def _add_box(figure: "Figure", box: Box, keys: tuple[str, str], look: Look) -> None:
    """The box of one design, where it has an extent."""
    (x, y), (dx, dy) = ([part[key] for key in keys] for part in (box.centre, box.half))
    if dx <= 0 and dy <= 0:
        return
    figure.add_scatter(
        x=[x - dx, x + dx, x + dx, x - dx, x - dx],
        y=[y - dy, y - dy, y + dy, y + dy, y - dy],
        mode="lines",
        line={"color": look.colour, "width": 1.8, "dash": box.dash},
        fill="toself",
        fillcolor=look.fill(0.07),
        legendgroup=plain(box.design),
        showlegend=False,
        hoverinfo="skip",
    )


def _reach(boxes: Sequence[Box], key: str, axes: Mapping[str, Axis]) -> list[float]:
    """A range that shows every box and limit completely."""
    ends = [box.centre[key] + side * box.half[key] for box in boxes for side in (-1, 1)]
    return padded([*ends, *axes[key].limits.values()])


def _hover(box: Box, keys: tuple[str, str], axes: Mapping[str, Axis]) -> str:
    rows = [f"<b>{plain(box.design)}</b>{plain(box.note and ', ' + box.note)}"]
    for key in keys:
        unit = axes[key].unit
        spread = f" ± {number(box.half[key], 3)}" if box.half[key] > 0 else ""
        rows.append(f"{plain(axes[key].name)}: {number(box.centre[key], 4)}{spread} {plain(unit)}")
    return "<br>".join(rows) + "<extra></extra>"


_ROW, _AROUND = 44, 130


def decisions_figure(solution: Solution) -> "Figure":
    """Each decision between its bounds, in percent of the way from the lower to the upper one, with where it began.

    An array of decisions has one marker for each entry. Decisions without two finite bounds have no such place. Raises
    `ProblemError` if there is no other.
    """
    places = {name: one.decision for name, one in solution.problem.placements.decisions.items()}
    shown = {name: one for name, one in places.items() if np.all(np.isfinite(np.subtract(one.upper, one.lower)))}
    if not shown:
        raise ProblemError(
            f"plot.decisions: expected a decision with two finite bounds; received {list(places)} without them."
        )
    figure = blank(label("Way from the lower to the upper bound", "%"), "", height=_AROUND + _ROW * len(shown))
    look = looks(["design"])["design"]
    for first, (name, one) in zip([True] + [False] * len(shown), shown.items(), strict=False):
        low, wide = np.asarray(one.lower, float), np.subtract(one.upper, one.lower)
        rows = (
            ("start", one.initial, f"{look.symbol}-open", MUTED),
            ("design", solution.decisions[name], look.symbol, look.colour),
        )
        unit = unit_of_decision(name, solution.problem)
        figure.add_scatter(
            x=[0, 100],
            y=[plain(name)] * 2,
            mode="lines",
            line={"color": MUTED, "width": 1},
            showlegend=False,
            hoverinfo="skip",
        )
        for kind, values, symbol, colour in rows:
            ways = np.ravel(100 * (np.asarray(values, float) - low) / np.where(wide > 0, wide, 1.0))
            figure.add_scatter(
                x=ways,
                y=[plain(name)] * len(ways),
                mode="markers",
                name=kind,
                legendgroup=kind,
                showlegend=first,
                marker={"symbol": symbol, "size": 10, "color": colour},
                text=[f"{number(value, 5, plain(unit))}" for value in np.ravel(values)],
                hovertemplate=f"<b>{plain(name)}</b>, {kind}: %{{text}}<extra></extra>",
                cliponaxis=False,
            )
        _tell(figure, name, one, solution.decisions[name], unit)
    figure.update_xaxes(range=[-4, 104])
    figure.update_yaxes(type="category", range=[len(shown) - 0.5, -0.7], showgrid=False)
    return figure


def _tell(figure: "Figure", name: str, decision: Decision, value: Any, unit: str) -> None:
    """The value, and the bounds, in words above the row; of an array the bounds alone."""
    low, high = float(np.min(decision.lower)), float(np.max(decision.upper))
    told = f"{number(float(value), 5, unit)}, " if np.ndim(value) == 0 else ""
    figure.add_annotation(
        x=100,
        y=plain(name),
        xanchor="right",
        yanchor="bottom",
        yshift=9,
        text=plain(f"{told}between {given(low)} and {given(high, unit)}"),
        showarrow=False,
        font={"size": SIZE - 2, "color": LIMIT},
    )


# A point that violates a constraint by more than this, relative to its magnitude, is drawn as one that does not hold.
_HELD = 1e-2
# The axis shows the best values and this part of all others: a few are often far above.
_SHOWN = 0.8
_CAPTION = (
    "Each point is one simulated design; those that violate a constraint by more than one part in a hundred are drawn "
    "as crosses. The line is the best of the others so far, from which derivatives continue."
)


def search_drawings(designs: Mapping[str, Solution]) -> list[Drawing]:
    """The searches for some designs, by their names, for a page: of those that were searched for."""
    drawn = []
    for name, one in designs.items():
        searched = one.effort.searched
        if searched is not None and searched.evaluations:
            figure = search_figure(searched, unit_of_objective(one.problem))
            drawn.append(Drawing([figure], f"Search for {name} by {searched.method}", _CAPTION))
    return drawn


def search_figure(searched: Searched, unit: str = "") -> "Figure":
    """The objective, in its `unit`, of every point that a search evaluated, in order, and the best so far."""
    figure = blank(label("Evaluation"), label("Objective", unit))
    order, held = 1 + np.arange(searched.evaluations), searched.violations <= _HELD
    values = {"feasible": np.where(held, searched.objectives, np.nan)}
    if not held.all():
        values["violates a constraint"] = np.where(held, np.nan, searched.objectives)
    for (name, some), symbol, colour in zip(values.items(), ("circle", "x-thin"), (MUTED, ALARM), strict=False):
        figure.add_scatter(
            x=short(order),
            y=short(some),
            mode="markers",
            name=plain(name),
            marker={
                "symbol": symbol,
                "size": 4,
                "color": colour,
                "opacity": 0.5,
                "line": {"color": colour, "width": 1},
            },
            hovertemplate="evaluation %{x}: %{y:.5g}<extra></extra>",
        )
    best, look = searched.best(_HELD), looks(["best so far"])["best so far"]
    figure.add_scatter(
        x=short(order),
        y=short(best),
        mode="lines",
        name="best so far",
        line={"color": look.colour, "width": 2, "shape": "hv"},
        hovertemplate="best of %{x}: %{y:.5g}<extra></extra>",
    )
    known = searched.objectives[np.isfinite(searched.objectives)]
    if len(known):
        figure.update_yaxes(range=padded([*known[known <= np.quantile(known, _SHOWN)], *best[np.isfinite(best)]]))
    return figure


# From the first mesh to the last: shades of one hue, so that their order is seen without telling colours apart.
_FIRST, _LAST = (163, 196, 220), (0, 76, 120)
# Heights in pixels: of the errors, of one mesh's nodes with their name, and of what surrounds both.
_ERRORS, _MESH_ROW, _AROUND_MESHES = 260, 46, 90
# How far the marks of nodes reach up and down in their row, and how much of the height lies between both parts.
_REACH, _BETWEEN = 0.16, 0.05
# Powers of ten that are all named, and room for a line that lies on one.
_MOST_TICKS, _ROOM = 8, 0.1

_NODES = (
    "Above, the nodes of each mesh. Below, how far states drift from their equations within each interval, relative to "
    "their magnitudes, in the realisation that is worst there."
)
_REFINED = " The last mesh is the darkest. Intervals above the dashed line were divided, or their order was raised."


def mesh_drawing(meshes: Sequence[MeshError], name: str) -> Drawing:
    """The meshes of the design called `name`, for a page."""
    caption = _NODES + _REFINED * (len(meshes) > 1)
    return Drawing([mesh_figure(meshes)], f"Meshes of {name}", caption)


def mesh_figure(meshes: Sequence[MeshError]) -> "Figure":
    """The history of the meshes of a solution: the nodes of each, and below them the error of each interval."""
    rows = len(meshes) * _MESH_ROW
    share = _ERRORS / (_ERRORS + rows)
    figure = blank(label("Time", "s"), "Drift of the states", height=_AROUND_MESHES + _ERRORS + rows)
    for i, (mesh, colour) in enumerate(zip(meshes, _shades(len(meshes)), strict=True)):
        is_last = i == len(meshes) - 1
        scheme = "" if i and mesh.scheme == meshes[i - 1].scheme else f" of {mesh.scheme}"
        end = _verdict(mesh) if is_last else ""
        name = f"Mesh {i + 1}: {count(mesh.intervals)} intervals{scheme}, {residual(mesh.worst)}{end}"
        _add_nodes(figure, mesh, i, colour, name)
        _add_errors(figure, mesh, i, colour, width=2.0 if is_last else 1.3)
    _add_request(figure, meshes[-1])
    figure.update_xaxes(range=padded(meshes[-1].nodes[[0, -1]], 0.01))
    low, high = _decades(meshes)
    errors = {"domain": [0, share - _BETWEEN], "type": "log", "exponentformat": "power", "range": [low, high]}
    errors["dtick"] = 1 if high - low <= _MOST_TICKS else 2
    nodes = {"domain": [share, 1], "range": [len(meshes) - 0.5, -0.75], "visible": False, "fixedrange": True}
    figure.update_layout(showlegend=False, yaxis=errors, yaxis2=nodes)
    return figure


def _verdict(mesh: MeshError) -> str:
    if np.isinf(mesh.asked):
        return ""
    return ", as asked" if mesh.is_met else ", more than asked"


def _decades(meshes: Sequence[MeshError]) -> tuple[int, int]:
    """The powers of ten between which all errors lie, and the one asked for; what is smaller than rounding is cut."""
    errors = np.concatenate([one.errors for one in meshes] + [[one.asked] for one in meshes if np.isfinite(one.asked)])
    powers = np.log10(np.maximum(errors, np.finfo(float).eps))
    return int(np.floor(powers.min() - _ROOM)), int(np.ceil(powers.max() + _ROOM))


def _shades(number: int) -> list[str]:
    """Colours from the first mesh to the last; one alone has the last."""
    ways = np.linspace(0.0, 1.0, number) if number > 1 else np.ones(1)
    mixed = np.rint(np.outer(1 - ways, _FIRST) + np.outer(ways, _LAST)).astype(int)
    return [f"rgb({red},{green},{blue})" for red, green, blue in mixed.tolist()]


def _add_nodes(figure: "Figure", mesh: MeshError, row: int, colour: str, name: str) -> None:
    """The nodes of a mesh as marks in a row, under its name: one line with gaps, however many they are."""
    figure.add_scatter(
        x=short(np.repeat(mesh.nodes, 3)),
        y=short(np.tile([row - _REACH, row + _REACH, np.nan], len(mesh.nodes))),
        yaxis="y2",
        mode="lines",
        line={"color": colour, "width": 1},
        name=f"nodes of mesh {row + 1}",
        hoverinfo="skip",
    )
    figure.add_annotation(
        text=name,
        xref="paper",
        x=0,
        xanchor="left",
        yref="y2",
        y=row - _REACH,
        yanchor="bottom",
        showarrow=False,
        font={"size": SIZE - 2, "color": INK},
    )


def _add_errors(figure: "Figure", mesh: MeshError, row: int, colour: str, width: float) -> None:
    """The error of each interval as a step; one that is zero has no place on a logarithmic axis."""
    errors = np.where(mesh.errors > 0, mesh.errors, np.nan)
    figure.add_scatter(
        x=short(mesh.nodes),
        y=short(np.append(errors, errors[-1])),
        mode="lines",
        line={"color": colour, "width": width, "shape": "hv"},
        name=f"errors of mesh {row + 1}",
        hovertemplate=f"mesh {row + 1}: %{{y:.2~e}} from %{{x:.4~g}} s<extra></extra>",
    )


def _add_request(figure: "Figure", mesh: MeshError) -> None:
    """The error that was asked for, as a line."""
    if np.isinf(mesh.asked):
        return
    figure.add_scatter(
        x=short(mesh.nodes[[0, -1]]),
        y=[mesh.asked, mesh.asked],
        mode="lines+text",
        text=["", f"{residual(mesh.asked)} asked"],
        textposition="top left",
        textfont={"size": SIZE - 1, "color": LIMIT},
        line={"color": LIMIT, "width": 1.3, "dash": "dash"},
        name="asked",
        hoverinfo="skip",
    )
