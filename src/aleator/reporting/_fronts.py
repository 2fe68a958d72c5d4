"""Figures of sweeps: what lies along a bound (optima, shadow prices, decisions), trade-offs, growing penalties."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from aleator.reporting._numbers import (
    given,
    number,
    unit_of_expression,
    unit_of_limit,
    unit_of_objective,
)
from aleator.reporting._style import (
    DASHES,
    LIMIT,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    legend_entry,
    limit_line,
    looks,
    padded,
    plain,
)
from aleator.solution import Solution
from aleator.sweep import Front, Refused, TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Values that differ by less than this part are shown as equal: the rest is what solvers' tolerances leave.
_FLAT = 1e-6


def in_order(fronts: Mapping[str, Front]) -> dict[str, tuple[Front, list[int]]]:
    """Each front by its bounds, as they are where these rise or fall throughout, and the places of its points among
    those of all as they were given, by which a page links them with their designs.
    """
    ordered, before = {}, 0
    for name, front in fronts.items():
        changes, order = np.diff(front.values), np.arange(len(front.values))
        if not (np.all(changes >= 0) or np.all(changes <= 0)):
            order = np.argsort(front.values, kind="stable")
        points = tuple(front.points[i] for i in order)
        ordered[name] = replace(front, values=front.values[order], points=points), (before + order).tolist()
        before += len(order)
    return ordered


def bound_unit(front: Front) -> str:
    """The unit of the bound along which a front lies."""
    return unit_of_limit(front.bound, front.points[0].problem)


def _bound(front: Front) -> tuple[str, str]:
    return f"Limit of {front.bound}", bound_unit(front)


def front_figure(
    fronts: Mapping[str, Front],
    *,
    x: str = "",
    y: str = "",
    x_unit: str = "",
    y_unit: str = "",
    limits: Mapping[str, float] = MappingProxyType({}),
    infeasible: Mapping[str, Front] = MappingProxyType({}),
) -> "Figure":
    """The optimum against the bound, one line for each front; axes without a name have those of the problem.

    A marker is filled where the swept bound is active and open where it is not. Points without a
    solution are crosses on the axis; their hover text says what cannot be met. `limits` are drawn as lines;
    `infeasible` shades the bounds at which another design does not exist.
    """
    first = next(iter(fronts.values()))
    x, x_unit = (x, x_unit) if x else _bound(first)
    y, y_unit = (y, y_unit) if y else ("Objective", unit_of_objective(first.points[0].problem))
    figure = blank(label(x, x_unit), label(y, y_unit))
    low, high = _range(fronts, list(limits.values()))
    step, rows = 0.07 * (high - low), 1
    for row, (name, (front, places)) in enumerate(in_order(fronts).items(), start=1):
        look = looks(fronts)[name]
        legend_entry(figure, name, look)
        texts = {"text": [_hover(front, i) for i in range(len(front.points))], "showlegend": False}
        _add_points(figure, name, front, look, front.objectives, y_unit, "%{text}", places, **texts)
        if not front.solved.all():
            rows = row + 1
            _add_infeasible(figure, name, front, look, low - step * row, x_unit, places)
    # Leaves room below the data for the label of the shaded band.
    rows += 1 if infeasible else 0
    figure.update_yaxes(range=[low - step * rows, high + step])
    for text, value in limits.items():
        limit_line(figure, value, text)
    for name, front in infeasible.items():
        _shade_infeasible(figure, name, front)
    return figure


def shadow_price_figure(
    fronts: Mapping[str, Front], *, x: str = "", y: str = "", x_unit: str = "", y_unit: str = "", scale: float = 1.0
) -> "Figure":
    """The value of relaxing a bound: the multiplier along each front, times `scale`; axes as of `front_figure`."""
    first = next(iter(fronts.values()))
    x, x_unit = (x, x_unit) if x else _bound(first)
    if not y:
        unit, by = unit_of_objective(first.points[0].problem), bound_unit(first)
        y, y_unit = "Shadow price of the bound", f"{unit or '1'} per {by}" if by else ""
    figure = blank(label(x, x_unit), label(y, y_unit), height=360)
    for name, (front, places) in in_order(fronts).items():
        price, below = scale * front.shadow_prices, f"limit %{{x:.4~g}} {plain(x_unit)}"
        _add_points(figure, name, front, looks(fronts)[name], price, y_unit, below, places, cliponaxis=False)
    return figure.update_yaxes(rangemode="tozero")


def _range(fronts: Mapping[str, Front], extra: list[float]) -> tuple[float, float]:
    values = [one.objective for front in fronts.values() for one in front.optima if one] + extra
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    if high - low > _FLAT * max(abs(low), abs(high)):
        return low, high
    return low - 0.5 * abs(low or 1.0), high + 0.5 * abs(high or 1.0)


def _add_points(
    figure: "Figure",
    name: str,
    front: Front,
    look: Look,
    values: Float[np.ndarray, " points"],
    unit: str,
    below: str,
    places: list[int],
    **style: Any,
) -> None:
    """The solved points as one line, interrupted where a point between them has no solution; filled where the swept
    bound is active.
    """
    active = [isinstance(one, Solution) and one.multiplier(front.bound) > 0 for one in front.points]
    symbols = [look.symbol if is_active else f"{look.symbol}-open" for is_active in active]
    hover = f"<b>{plain(name)}</b>: %{{y:.4~g}} {plain(unit)}<br>{below}"
    marks = {"marker_symbol": symbols, "marker_line_width": 2, "marker_line_color": look.colour}
    linked = {"name": name, "legendgroup": plain(name), "meta": places, "hover": hover}
    draw(figure, front.values, values, look, **linked, **marks, **style)


def _hover(front: Front, i: int) -> str:
    solution = front.points[i]
    if isinstance(solution, Refused):
        return ""
    shadow_price = f"<br>shadow price of the bound {number(solution.multiplier(front.bound), 3)} per unit"
    active = ", ".join(dict.fromkeys(name.split("[")[0] for name in solution.active)) or "nothing"
    decisions = "".join(
        f"<br>{plain(key)} = {number(float(value))}" for key, value in solution.decisions.items() if not np.ndim(value)
    )
    return f"{plain(front.bound)} limit {number(front.values[i])}<br>active: {plain(active)}{shadow_price}{decisions}"


def _add_infeasible(
    figure: "Figure", name: str, front: Front, look: Look, height: float, unit: str, places: list[int]
) -> None:
    """Points without a solution, on the axis, with the smallest violations."""
    missing = [i for i, one in enumerate(front.points) if not one.ok]
    last, middle = max(missing, key=lambda i: front.values[i]), (front.values.min() + front.values.max()) / 2
    draw(
        figure,
        front.values[missing],
        [height] * len(missing),
        Look(look.colour, "x"),
        name=f"{name}: no design exists",
        mode="markers+text",
        hover=f"<b>{plain(name)}</b>: not solved at %{{x:.4~g}} {plain(unit)}<br>%{{customdata}}",
        text=[f" {plain(name)} infeasible" if i == last else "" for i in missing],
        textposition="middle right" if front.values[last] < middle else "middle left",
        textfont={"size": SIZE - 1, "color": look.colour},
        customdata=[_why(front.points[i]) for i in missing],
        meta=[places[i] for i in missing],
        showlegend=False,
        cliponaxis=False,
    )


def _why(solution: Solution | Refused) -> str:
    """Status and smallest violations, one per line, as hover text."""
    if isinstance(solution, Refused):
        return f"{plain(solution.status.value)}<br>{plain(solution.reason)}"
    lines = [plain(solution.status.value), *(plain(one.sentence()) for one in solution.violated)]
    return "<br>".join([*lines, f"smallest scaled violation {number(solution.certificate.violation, 3)}"])


def _shade_infeasible(figure: "Figure", name: str, front: Front) -> None:
    """A band over the bounds at which a design does not exist, up to the middle of the next interval."""
    missing = front.values[~front.solved]
    if not len(missing):
        return
    gap = float(np.min(np.abs(np.diff(np.sort(front.values))))) / 2 if len(front.values) > 1 else 0.0
    low, high = float(missing.min()) - gap, float(missing.max()) + gap
    figure.add_vrect(x0=low, x1=high, fillcolor=MUTED, opacity=0.13, line_width=0)
    place = {"x": high, "y": 0.02, "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    font = {"size": SIZE - 1, "color": LIMIT}
    figure.add_annotation(text=f"◄ no {plain(name)} exists here", showarrow=False, font=font, **place)


def decision_path_figure(
    fronts: Mapping[str, Front],
    across: str,
    up: str,
    *,
    x: str,
    y: str,
    bound_unit: str = "",
    lower: float | None = None,
    lower_text: str = "",
) -> "Figure":
    """Two decisions against each other along each front (figure 6.8); the rightmost end is labelled with its bound."""
    figure = blank(plain(x), plain(y))
    for name, (front, _) in in_order(fronts).items():
        look = looks(fronts)[name]
        solved = [(value, one) for value, one in zip(front.values, front.optima, strict=True) if one]
        xs, ys = ([float(one.decisions[key]) for _, one in solved] for key in (across, up))
        bounds = [given(float(f"{value:.4g}"), bound_unit) for value, _ in solved]
        # Labels at both ends of several fronts would overlap.
        texts = [text if place == max(xs) else "" for place, text in zip(xs, bounds, strict=True)]
        hover = (
            f"<b>{plain(name)}</b>, {plain(front.bound)} limit %{{customdata}}"
            f"<br>{plain(across)} = %{{x:.5~g}}<br>{plain(up)} = %{{y:.5~g}}"
        )
        marks = {"line_width": 1.5, "marker_symbol": f"{look.symbol}-open", "marker_size": 10, "marker_line_width": 2}
        written = {"text": texts, "textposition": "middle left", "textfont": {"size": SIZE - 2, "color": look.colour}}
        named = {"name": name, "customdata": bounds, "hover": hover, "cliponaxis": False}
        draw(figure, xs, ys, look, mode="lines+markers+text", **named, **marks, **written)
    if lower is not None:
        limit_line(figure, lower, lower_text, dash="dot", under=True)
        reached = [float(one.decisions[up]) for front in fronts.values() for one in front.optima if one]
        figure.update_yaxes(range=padded([lower, *reached], 0.12))
    return figure.update_yaxes(tickformat=",d")


def relative_figure(front: Front, names: Mapping[str, str], *, x: str, y: str, x_unit: str = "") -> "Figure":
    """Decisions along a front in percent of their initial values (figure 7.5); `names` are their labels."""
    (front, _), figure = in_order({"": front})[""], blank(label(x, x_unit), plain(y))
    places = front.solutions[0].problem.placements.designed
    for (name, text), look, dash in zip(names.items(), looks(names).values(), DASHES, strict=False):
        values = [float(one.decisions[name]) if one else np.nan for one in front.optima]
        hover = f"<b>{plain(text)}</b>: %{{customdata}}, %{{y:.4~g}} % of the initial value"
        shown = {"name": text, "customdata": [number(one) for one in values], "hover": hover, "line_dash": dash}
        draw(figure, front.values, 100 * np.array(values) / float(places[name].decision.initial), look, **shown)
    limit_line(figure, 100.0, "initial value (100 %)")
    _shade_infeasible(figure, "design", front)
    return figure.update_yaxes(rangemode="tozero")


def unit_of(front: TradeOff, which: int) -> str:
    """The unit of a wish; empty where it is unknown."""
    return unit_of_expression(front.wishes[which], front.solutions[0].problem) if front.solutions else ""


def wishes_text(front: TradeOff) -> list[str]:
    """The values of all wishes of each design, to be shown over its point."""
    named = [(plain(name), unit_of(front, i)) for i, name in enumerate(front.names)]
    rows = [
        [f"{name}: {plain(number(float(value), 5, unit))}" for (name, unit), value in zip(named, row, strict=True)]
        for row in front.values
    ]
    return ["<br>".join(row) for row in rows]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    figure = blank(*(label(front.names[i], unit_of(front, i)) for i in (first, second)))
    look, (x, y) = looks(["design"])["design"], (front.values[:, i] for i in (first, second))
    line = {"line_color": look.fill(0.4), "line_width": 1.5} if len(front.names) == 2 else {"mode": "markers"}
    draw(figure, x, y, look, hover="%{text}", text=wishes_text(front), meta=list(range(len(x))), **line)
    return figure.update_layout(showlegend=False)
