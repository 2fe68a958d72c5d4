"""Figures of designs: decisions between their bounds, and boxes of mean ± sigma in the space of requirements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting import _units
from aleator.reporting._numbers import given, number
from aleator.reporting._style import DASHES, LIMIT, MUTED, SIZE, Look, blank, label, limit_line, looks, padded, plain
from aleator.solution import Solution
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
        unit = _units.of_decision(name, solution.problem)
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
