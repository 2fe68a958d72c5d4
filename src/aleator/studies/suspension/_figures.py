"""Figures of the suspension alone: designs among their requirements, and decisions along its fronts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import numpy as np

import aleator as al
from aleator.reporting import (
    DASHES,
    MUTED,
    SIZE,
    blank,
    draw,
    given,
    in_order,
    label,
    limit_line,
    looks,
    number,
    padded,
    plain,
)

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
    for i, box in enumerate(boxes):
        (x, y), (dx, dy) = ([part[key] for key in keys] for part in (box.centre, box.half))
        look, group, spread = styles[box.design], plain(box.design), [box.note]
        if dx > 0 or dy > 0:
            corners = {"x0": x - dx, "x1": x + dx, "y0": y - dy, "y1": y + dy}
            line = {"color": look.colour, "width": 1.8, "dash": box.dash}
            filled = {"fillcolor": look.fill(0.07), "line": line, "layer": "below"}
            figure.add_shape(type="rect", legendgroup=group, **corners, **filled)
            spread += [f"{axes[key].name} ± {number(box.half[key], 3, axes[key].unit)}" for key in keys]
        first = box.design not in [other.design for other in boxes[:i]]
        marks = {"marker_size": 11, "marker_line_color": "white", "marker_line_width": 1, "mode": "markers"}
        named = {"name": box.design, "legendgroup": group, "showlegend": first}
        draw(figure, [x], [y], look, hover="<br>".join(map(plain, filter(None, spread))), **named, **marks)
    for key, axis in ((across, "x"), (up, "y")):
        limits = axes[key].limits
        for i, (text, value) in enumerate(limits.items()):
            limit_line(figure, value, text, axis=axis, dash=DASHES[i % len(DASHES)] if len(limits) > 1 else "dash")
        ends = [box.centre[key] + side * box.half[key] for box in boxes for side in (-1, 1)]
        figure.update_layout({f"{axis}axis_range": padded([*ends, *limits.values()])})
    return figure


def decision_path_figure(fronts: Mapping[str, al.results.Front], lowest: float) -> "Figure":
    """Spring and damper along each front (figure 6.8), above the spring's lower bound; the rightmost end is labelled
    with its bound.
    """
    figure, reached = blank("Damper, mean bₛ (N s/m)", "Spring, mean kₛ (N/m)"), [lowest]
    for name, (front, _) in in_order(fronts).items():
        look, solved = looks(fronts)[name], [one for one in front.optima if one]
        xs, ys = ([float(one.decisions[key]) for one in solved] for key in ("b_s.mean", "k_s.mean"))
        bounds = [given(float(f"{value:.4g}"), "m") for value in front.values[front.solved]]
        # Labels at both ends of several fronts would overlap.
        texts = [text if place == max(xs) else "" for place, text in zip(xs, bounds, strict=True)]
        marks = {"line_width": 1.5, "marker_symbol": f"{look.symbol}-open", "marker_size": 10, "marker_line_width": 2}
        written = {"text": texts, "textposition": "top left", "textfont": {"size": SIZE - 2, "color": look.colour}}
        over = {"customdata": bounds, "hover": f"{plain(front.bound)} limit: %{{customdata}}", "cliponaxis": False}
        draw(figure, xs, ys, look, name=name, mode="lines+markers+text", **over, **marks, **written)
        reached += ys
    limit_line(figure, lowest, f"lower bound of kₛ, {number(lowest)} N/m", dash="dot")
    return figure.update_yaxes(range=padded(reached, 0.12), tickformat=",d")


def relative_figure(front: al.results.Front, names: Mapping[str, str], x: str, y: str) -> "Figure":
    """Decisions along a front in percent of their initial values (figure 7.5); `names` are their labels."""
    (front, _), figure = in_order({"": front})[""], blank(x, y)
    places = front.solutions[0].problem.placements.designed
    for (name, text), look, dash in zip(names.items(), looks(names).values(), DASHES, strict=False):
        values = np.array([float(one.decisions[name]) if one else np.nan for one in front.optima])
        over = {"customdata": [number(one) for one in values], "hover": "%{customdata}", "line_dash": dash}
        draw(figure, front.values, 100 * values / float(places[name].decision.initial), look, name=text, **over)
    limit_line(figure, 100.0, "initial value (100 %)")
    return shaded(figure.update_yaxes(rangemode="tozero"), "design", front)


def shaded(figure: "Figure", name: str, front: al.results.Front) -> "Figure":
    """The same with a band over the bounds at which a design does not exist, up to the middle of the next interval."""
    missing = front.values[~front.solved]
    if len(missing):
        gap = float(np.min(np.abs(np.diff(np.sort(front.values))))) / 2 if len(front.values) > 1 else 0.0
        low, high = float(missing.min()) - gap, float(missing.max()) + gap
        figure.add_vrect(x0=low, x1=high, fillcolor=MUTED, opacity=0.13, line_width=0)
        place = {"x": high, "y": 0.98, "yref": "paper", "xanchor": "right", "yanchor": "top"}
        figure.add_annotation(text=f"no {name} exists here ", showarrow=False, font={"size": SIZE - 1}, **place)
    return figure
