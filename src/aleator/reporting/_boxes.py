"""Figures of designs in the space of their requirements: nominal points, boxes of mean ± sigma, limits as lines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

from aleator.reporting._numbers import number
from aleator.reporting._style import Look, blank, label, limit_line, looks, padded, plain

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


DASHES = ("solid", "dash", "dot", "dashdot")
"""Lines of boxes and limits that belong together."""


def _hover(box: Box, keys: tuple[str, str], axes: Mapping[str, Axis]) -> str:
    rows = [f"<b>{plain(box.design)}</b>{plain(box.note and ', ' + box.note)}"]
    for key in keys:
        unit = axes[key].unit
        spread = f" ± {number(box.half[key], 3)}" if box.half[key] > 0 else ""
        rows.append(f"{plain(axes[key].name)}: {number(box.centre[key], 4)}{spread} {plain(unit)}")
    return "<br>".join(rows) + "<extra></extra>"
