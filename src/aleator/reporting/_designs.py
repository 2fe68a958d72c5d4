"""Figures of designs: decisions between their bounds, boxes of mean ± sigma in the space of requirements; and of how
a design came about: what a search evaluated, and the meshes of a simultaneous program.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import numpy as np

from aleator._core.errors import ProblemError
from aleator.nlp import Searched
from aleator.reporting._numbers import count, number, residual, unit_of_objective
from aleator.reporting._page import Drawing
from aleator.reporting._style import (
    ALARM,
    DASHES,
    MUTED,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    padded,
    plain,
    short,
)
from aleator.solution import MeshError, Solution

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
    keys, styles = (across, up), looks(dict.fromkeys(box.design for box in boxes))
    figure = blank(*(label(axes[key].name, axes[key].unit) for key in keys), height=height)
    # All boxes first, so that none covers a point.
    for box in boxes:
        (x, y), (dx, dy) = ([part[key] for key in keys] for part in (box.centre, box.half))
        if dx > 0 or dy > 0:
            look, xs = styles[box.design], [x - dx, x + dx, x + dx, x - dx, x - dx]
            ys = [y - dy, y - dy, y + dy, y + dy, y - dy]
            filled = {"fill": "toself", "fillcolor": look.fill(0.07), "line_dash": box.dash, "line_width": 1.8}
            group = {"legendgroup": plain(box.design), "showlegend": False}
            draw(figure, xs, ys, look, mode="lines", **filled, **group)
    for i, box in enumerate(boxes):
        first = box.design not in [other.design for other in boxes[:i]]
        marks = {"marker_size": 11, "marker_line_color": "white", "marker_line_width": 1}
        named = {"name": box.design, "legendgroup": plain(box.design), "showlegend": first}
        x, y = ([box.centre[key]] for key in keys)
        draw(figure, x, y, styles[box.design], mode="markers", hover=_hover(box, keys, axes), **named, **marks)
    for key, axis in ((across, "x"), (up, "y")):
        limits = axes[key].limits
        for i, (text, value) in enumerate(limits.items()):
            limit_line(figure, value, text, axis=axis, dash=DASHES[i % len(DASHES)] if len(limits) > 1 else "dash")
        ends = [box.centre[key] + side * box.half[key] for box in boxes for side in (-1, 1)]
        figure.update_layout({f"{axis}axis_range": padded([*ends, *limits.values()])})
    return figure


def _hover(box: Box, keys: tuple[str, str], axes: Mapping[str, Axis]) -> str:
    rows = [f"<b>{plain(box.design)}</b>{plain(box.note and ', ' + box.note)}"]
    for key in keys:
        spread = f" ± {number(box.half[key], 3)}" if box.half[key] > 0 else ""
        rows.append(f"{plain(axes[key].name)}: {number(box.centre[key], 4)}{spread} {plain(axes[key].unit)}")
    return "<br>".join(rows)


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
    searches = {name: (one.effort.searched, unit_of_objective(one.problem)) for name, one in designs.items()}
    return [
        Drawing([search_figure(searched, unit)], f"Search for {name} by {searched.method}", _CAPTION)
        for name, (searched, unit) in searches.items()
        if searched is not None and searched.evaluations
    ]


def search_figure(searched: Searched | None, unit: str = "") -> "Figure":
    """The objective, in its `unit`, of every point that a search evaluated, in order, and the best so far.

    Raises `ProblemError` where there was no search, or none that evaluated anything.
    """
    if searched is None or not searched.evaluations:
        raise ProblemError("plot.search: expected a search, or a solve, that evaluated designs; received none.")
    figure = blank(label("Evaluation"), label("Objective", unit))
    order, held = short(1 + np.arange(searched.evaluations)), searched.violations <= _HELD
    groups = [("feasible", held, Look(MUTED, "circle"))]
    groups += [] if held.all() else [("violates a constraint", ~held, Look(ALARM, "x-thin"))]
    for name, of_kind, look in groups:
        small = {"marker_size": 4, "marker_opacity": 0.5, "marker_line_color": look.colour, "marker_line_width": 1}
        values = short(np.where(of_kind, searched.objectives, np.nan))
        draw(figure, order, values, look, name=name, mode="markers", hover="evaluation %{x}: %{y:.5g}", **small)
    best, look = searched.best(_HELD), looks(["best so far"])["best so far"]
    steps = {"mode": "lines", "line_shape": "hv", "hover": "best of %{x}: %{y:.5g}"}
    draw(figure, order, short(best), look, name="best so far", **steps)
    known = searched.objectives[np.isfinite(searched.objectives)]
    if len(known):
        figure.update_yaxes(range=padded([*known[known <= np.quantile(known, _SHOWN)], *best[np.isfinite(best)]]))
    return figure


# From the first mesh to the last: shades of one hue, so that their order is seen without telling colours apart.
_FIRST, _LAST = np.array((163, 196, 220)), np.array((0, 76, 120))

_NODES = (
    "How far states drift from their equations within each interval, relative to their magnitudes, in the realisation "
    "that is worst there; the marks are the nodes of the mesh."
)
_REFINED = " The last mesh is the darkest. Intervals above the dashed line were divided, or their order was raised."


def mesh_drawing(meshes: Sequence[MeshError], name: str) -> Drawing:
    """The meshes of the design called `name`, for a page."""
    caption = _NODES + _REFINED * (len(meshes) > 1)
    return Drawing([mesh_figure(meshes)], f"Meshes of {name}", caption)


def mesh_figure(meshes: Sequence[MeshError]) -> "Figure":
    """The history of the meshes of a solution: the error of each interval as a step, with marks at the nodes."""
    figure, last = blank(label("Time", "s"), "Drift of the states"), meshes[-1]
    for i, mesh in enumerate(meshes):
        way = (i + 1) / len(meshes)
        shade = np.rint((1 - way) * _FIRST + way * _LAST).astype(int).tolist()
        judged = mesh is last and np.isfinite(mesh.asked)
        verdict = "" if not judged else ", as asked" if mesh.is_met else ", more than asked"
        scheme = "" if i and mesh.scheme == meshes[i - 1].scheme else f" of {mesh.scheme}"
        # An error of zero has no place on a logarithmic axis.
        errors = np.where(mesh.errors > 0, mesh.errors, np.nan)
        steps = {
            "name": f"Mesh {i + 1}: {count(mesh.intervals)} intervals{scheme}, {residual(mesh.worst)}{verdict}",
            "hover": f"mesh {i + 1}: %{{y:.2~e}} from %{{x:.4~g}} s",
            **{"line_shape": "hv", "line_width": 2.0 if mesh is last else 1.3},
            **{"marker_size": 7, "marker_line_width": 1, "marker_line_color": f"rgb({','.join(map(str, shade))})"},
        }
        look = Look(steps["marker_line_color"], "line-ns")
        draw(figure, short(mesh.nodes), short(np.append(errors, errors[-1])), look, **steps)
    if np.isfinite(last.asked):
        limit_line(figure, last.asked, f"{residual(last.asked)} asked", logarithmic=True)
    figure.update_layout(showlegend=True).update_xaxes(range=padded(last.nodes[[0, -1]], 0.01))
    return figure.update_yaxes(type="log", exponentformat="power")
