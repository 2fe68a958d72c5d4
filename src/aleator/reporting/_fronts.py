"""Figures of fronts: the optimum, its shadow price, its decisions and its spreads along a bound."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from aleator.reporting._numbers import given, number
from aleator.reporting._style import (
    LIMIT,
    MUTED,
    SIZE,
    Look,
    blank,
    label,
    legend_entry,
    limit_line,
    looks,
    padded,
    plain,
)
from aleator.solution import Solution
from aleator.sweep import Front, Refused

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def ordered(front: Front) -> Front:
    """The front by its bounds, unless these rise or fall throughout."""
    return _arranged(front, _order(front))


def in_order(fronts: Mapping[str, Front]) -> dict[str, tuple[Front, list[int]]]:
    """Each front by its bounds, and the places of its points among those of all as they were given, by which a page
    links them with their designs.
    """
    found, before = {}, 0
    for name, front in fronts.items():
        order = _order(front)
        found[name] = _arranged(front, order), (before + order).tolist()
        before += len(order)
    return found


def _arranged(front: Front, order: Int[np.ndarray, " points"]) -> Front:
    return replace(front, values=front.values[order], points=tuple(front.points[i] for i in order))


def _order(front: Front) -> Int[np.ndarray, " points"]:
    changes = np.diff(front.values)
    is_in_order = bool(np.all(changes >= 0) or np.all(changes <= 0))
    return np.arange(len(front.values)) if is_in_order else np.argsort(front.values, kind="stable")


Measure = Callable[[Solution], float]

# Values that differ by less than this part are shown as equal: the rest is what solvers' tolerances leave.
_FLAT = 1e-6


def front_figure(
    fronts: Mapping[str, Front],
    *,
    x: str,
    y: str,
    x_unit: str = "",
    y_unit: str = "",
    measure: Measure | None = None,
    limits: Mapping[str, float] | None = None,
    infeasible: Mapping[str, Front] | None = None,
    title: str = "",
) -> "Figure":
    """The optimum (or another `measure` of each design) against the bound, one line for each front.

    A marker is filled where the swept bound is active and open where it is not. Points without a
    solution are crosses on the axis; their hover text says what cannot be met. `limits` are drawn as lines;
    `infeasible` shades the bounds at which another design does not exist.
    """
    figure = blank(label(x, x_unit), label(y, y_unit), title=title)
    shown = measure or (lambda solution: solution.objective)
    low, high = _range(fronts, shown, tuple((limits or {}).values()))
    step = 0.07 * (high - low)
    for row, (name, (front, places)) in enumerate(in_order(fronts).items()):
        look = looks(fronts)[name]
        _add_solved(figure, name, front, look, shown, (x_unit, y_unit), places)
        _add_infeasible(figure, name, front, look, low - step * (row + 1), x_unit, places)
    rows = 1 + max((i + 1 for i, one in enumerate(fronts.values()) if not one.solved.all()), default=0)
    # Leaves room below the data for the label of the shaded band.
    rows += 1 if infeasible else 0
    figure.update_yaxes(range=[low - step * rows, high + step])
    for text, value in (limits or {}).items():
        limit_line(figure, value, text)
    for name, front in (infeasible or {}).items():
        _shade_infeasible(figure, name, front)
    return figure


def _range(fronts: Mapping[str, Front], measure: Measure, extra: tuple[float, ...]) -> tuple[float, float]:
    values = [measure(one) for front in fronts.values() for one in front.optima if one] + list(extra)
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    if high - low > _FLAT * max(abs(low), abs(high)):
        return low, high
    return low - 0.5 * abs(low or 1.0), high + 0.5 * abs(high or 1.0)


def _add_solved(
    figure: "Figure", name: str, front: Front, look: Look, measure: Measure, units: tuple[str, str], places: list[int]
) -> None:
    """The solved points as one line, interrupted where a point between them has no solution."""
    values = [measure(one) if one else None for one in front.optima]
    legend_entry(figure, name, look)
    figure.add_scatter(
        x=front.values,
        y=values,
        mode="lines+markers",
        name=plain(name),
        legendgroup=plain(name),
        showlegend=False,
        line={"color": look.colour, "width": 2},
        marker={
            "symbol": _symbols(front, look),
            "size": 9,
            "color": look.colour,
            "line": {"color": look.colour, "width": 2},
        },
        text=[_hover(front, i) for i in range(len(front.points))],
        meta=places,
        hovertemplate=f"<b>{plain(name)}</b>: %{{y:.4~g}} {plain(units[1])}<br>%{{text}}<extra></extra>",
    )


def _symbols(front: Front, look: Look) -> list[str]:
    """The markers of a front's points: filled where the swept bound is active."""
    active = [isinstance(one, Solution) and one.multiplier(front.bound) > 0 for one in front.points]
    return [look.symbol if is_active else f"{look.symbol}-open" for is_active in active]


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
    if not missing:
        return
    last, middle = max(missing, key=lambda i: front.values[i]), (front.values.min() + front.values.max()) / 2
    figure.add_scatter(
        x=front.values[missing],
        y=[height] * len(missing),
        mode="markers+text",
        name=plain(f"{name}: no design exists"),
        showlegend=False,
        marker={"symbol": "x", "size": 10, "color": look.colour},
        text=[f" {plain(name)} infeasible" if i == last else "" for i in missing],
        textposition="middle right" if front.values[last] < middle else "middle left",
        textfont={"size": SIZE - 1, "color": look.colour},
        customdata=[_why(front.points[i]) for i in missing],
        meta=[places[i] for i in missing],
        hovertemplate=(
            f"<b>{plain(name)}</b>: not solved at %{{x:.4~g}} {plain(unit)}<br>%{{customdata}}<extra></extra>"
        ),
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
    figure.add_vrect(
        x0=float(missing.min()) - gap, x1=float(missing.max()) + gap, fillcolor=MUTED, opacity=0.13, line_width=0
    )
    figure.add_annotation(
        x=float(missing.max()) + gap,
        y=0.02,
        yref="paper",
        ax=28,
        ay=0,
        xanchor="left",
        yanchor="bottom",
        text=f"◄ no {plain(name)} exists here",
        showarrow=False,
        font={"size": SIZE - 1, "color": LIMIT},
    )


def shadow_price_figure(
    fronts: Mapping[str, Front], *, x: str, y: str, x_unit: str = "", y_unit: str = "", scale: float = 1.0
) -> "Figure":
    """The value of relaxing a bound: the multiplier along each front, times `scale`."""
    figure = blank(label(x, x_unit), label(y, y_unit), height=360)
    for name, (front, places) in in_order(fronts).items():
        look = looks(fronts)[name]
        figure.add_scatter(
            x=front.values,
            y=[scale * one.multiplier(front.bound) if one else None for one in front.optima],
            mode="lines+markers",
            name=plain(name),
            line={"color": look.colour, "width": 2},
            marker={"symbol": _symbols(front, look), "size": 8, "color": look.colour, "line": {"width": 2}},
            cliponaxis=False,
            meta=places,
            hovertemplate=(
                f"<b>{plain(name)}</b>: %{{y:.4~g}} {plain(y_unit)}<br>limit %{{x:.4~g}} {plain(x_unit)}<extra></extra>"
            ),
        )
    figure.update_yaxes(rangemode="tozero")
    return figure


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
        found = [(value, one) for value, one in zip(front.values, front.optima, strict=True) if one]
        places = [float(one.decisions[across]) for _, one in found]
        bounds = [given(float(f"{value:.4g}"), bound_unit) for value, _ in found]
        figure.add_scatter(
            x=places,
            y=[float(one.decisions[up]) for _, one in found],
            mode="lines+markers+text",
            name=plain(name),
            line={"color": look.colour, "width": 1.5},
            marker={"symbol": f"{look.symbol}-open", "size": 10, "color": look.colour, "line": {"width": 2}},
            # Labels at both ends of several fronts would overlap.
            text=[text if place == max(places) else "" for place, text in zip(places, bounds, strict=True)],
            textposition="middle left",
            textfont={"size": SIZE - 2, "color": look.colour},
            customdata=bounds,
            hovertemplate=(
                f"<b>{plain(name)}</b>, {plain(front.bound)} limit %{{customdata}}"
                f"<br>{plain(across)} = %{{x:.5~g}}<br>{plain(up)} = %{{y:.5~g}}<extra></extra>"
            ),
            cliponaxis=False,
        )
    if lower is not None:
        limit_line(figure, lower, lower_text, dash="dot", under=True)
        reached = [float(one.decisions[up]) for front in fronts.values() for one in front.optima if one]
        figure.update_yaxes(range=padded([lower, *reached], 0.12))
    figure.update_yaxes(tickformat=",d")
    return figure


def relative_figure(
    front: Front, names: Mapping[str, str], *, x: str, y: str, x_unit: str = "", reference: str = "initial value"
) -> "Figure":
    """Decisions along a front in percent of their initial values (figure 7.5); `names` are their labels."""
    front, figure = ordered(front), blank(label(x, x_unit), plain(y))
    starts = {name: front.solutions[0].problem.placements.decisions[name].decision.initial for name in names}
    styles: dict[str, dict[str, Any]] = {
        name: {"colour": colour, "symbol": symbol, "dash": dash}
        for (name, colour, symbol, dash) in zip(
            names,
            ("#0072b2", "#a3508a", "#b07400", "#5b5b5b"),
            ("square", "triangle-up", "circle", "diamond"),
            ("solid", "dash", "dot", "dashdot"),
            strict=False,
        )
    }
    for name, style in styles.items():
        figure.add_scatter(
            x=front.values,
            y=[100 * float(one.decisions[name]) / float(starts[name]) if one else None for one in front.optima],
            mode="lines+markers",
            name=plain(names[name]),
            line={"color": style["colour"], "width": 2, "dash": style["dash"]},
            marker={"symbol": style["symbol"], "size": 9, "color": style["colour"]},
            customdata=[number(float(one.decisions[name])) if one else "" for one in front.optima],
            hovertemplate=(
                f"<b>{plain(names[name])}</b>: %{{customdata}}, %{{y:.4~g}} % of the {reference}<extra></extra>"
            ),
        )
    limit_line(figure, 100.0, f"{reference} (100 %)")
    _shade_infeasible(figure, "design", front)
    figure.update_yaxes(rangemode="tozero")
    return figure
