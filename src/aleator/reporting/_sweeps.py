"""Figures of sweeps with the names and units of their problem: along a bound, trade-offs, growing penalties."""

import html
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from aleator.reporting._fronts import front_figure, ordered, shadow_price_figure
from aleator.reporting._numbers import (
    given,
    number,
    unit_of_decision,
    unit_of_expression,
    unit_of_limit,
    unit_of_objective,
)
from aleator.reporting._style import FONT, GRID, INK, MUTED, SIZE, blank, label, limit_line, looks, plain
from aleator.sweep import Front, Hardened, TradeOff

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def optimum_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The optimum along one bound, for some fronts by name, with the units of their problem."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), unit_of_objective(problem)
    return front_figure(fronts, y="Objective", y_unit=y_unit, x=f"Limit of {front.bound}", x_unit=x_unit)


def price_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The shadow price of one bound along it, for some fronts by name, with its unit."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), unit_of_objective(problem)
    per = f"{y_unit or '1'} per {x_unit}" if x_unit else ""
    x = f"Limit of {front.bound}"
    return shadow_price_figure(fronts, y="Shadow price of the bound", y_unit=per, x=x, x_unit=x_unit)


def bound_unit(front: Front) -> str:
    """The unit of the bound along which a front lies."""
    problem = front.solutions[0].problem
    return unit_of_limit(front.bound, problem)


def decision_figure(front: Front, name: str) -> "Figure":
    """A decision along the bound of a front, of an array each entry; gaps where there is no design."""
    front, problem = ordered(front), front.solutions[0].problem
    unit = unit_of_decision(name, problem)
    figure = blank(label(f"Limit of {front.bound}", bound_unit(front)), label(name, unit))
    shape = np.shape(problem.placements.decisions[name].decision.initial)
    entries = [f"{name}[{i}]" for i in range(int(np.prod(shape)))] if shape else [name]
    missing = np.full(len(entries), np.nan)
    rows = np.array([np.ravel(one.decisions[name]) if one else missing for one in front.optima], dtype=float)
    for (entry, look), column in zip(looks(entries).items(), rows.T, strict=True):
        figure.add_scatter(
            x=front.values,
            y=column,
            mode="lines+markers",
            name=plain(entry),
            line={"color": look.colour, "width": 2},
            marker={"symbol": look.symbol, "size": 8, "color": look.colour},
            hovertemplate=f"{plain(entry)} = %{{y:.5~g}} {plain(unit)} at %{{x:.4~g}}<extra></extra>",
        )
    return figure.update_layout(showlegend=len(entries) > 1)


def told_values(front: TradeOff, row: Sequence[float] | Float[np.ndarray, " wishes"]) -> list[str]:
    """The value of each wish with its unit."""
    return [number(float(one), 5, unit_of(front, i)) for i, one in enumerate(row)]


def trade_off_figure(front: TradeOff) -> "list[Figure]":
    """A figure for each pair of wishes: every design, with the values of all wishes to hover over."""
    return [pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]


def pair_figure(front: TradeOff, first: int, second: int) -> "Figure":
    """Two wishes, by their places among `front.names`, against one another."""
    x, y = ((front.names[i], unit_of(front, i)) for i in (first, second))
    figure = blank(label(*x), label(*y))
    look = looks(["design"])["design"]
    is_line = len(front.names) == 2
    figure.add_scatter(
        x=front.values[:, first],
        y=front.values[:, second],
        mode="lines+markers" if is_line else "markers",
        line={"color": look.fill(0.4), "width": 1.5},
        marker={"symbol": look.symbol, "size": 9, "color": look.colour},
        text=["<br>".join(_told(front, row)) for row in front.values],
        hovertemplate="%{text}<extra></extra>",
        meta=list(range(len(front.values))),
    )
    return figure.update_layout(showlegend=False)


def space_figure(front: TradeOff) -> "Figure":
    """The designs of three wishes as points in space, coloured by the third."""
    figure = blank("", "", height=560)
    figure.add_scatter3d(
        x=front.values[:, 0],
        y=front.values[:, 1],
        z=front.values[:, 2],
        mode="markers",
        marker={"size": 5, "color": front.values[:, 2], "colorscale": "Cividis", "line": {"width": 0.5, "color": INK}},
        text=["<br>".join(_told(front, row)) for row in front.values],
        hovertemplate="%{text}<extra></extra>",
    )
    axes = {
        f"{axis}axis": {
            "title": {"text": _in_space(name, unit_of(front, i))},
            "gridcolor": GRID,
            "linecolor": MUTED,
            "showbackground": False,
        }
        for i, (axis, name) in enumerate(zip("xyz", front.names, strict=True))
    }
    return figure.update_layout(scene=axes | {"camera": {"eye": {"x": 1.6, "y": 1.6, "z": 0.9}}}, showlegend=False)


def _in_space(name: str, unit: str) -> str:
    """A label in space, where Plotly reads markup but no escaped characters."""
    return html.unescape(label(name, unit)).replace("<", "‹").replace(">", "›")


def parallel_figure(front: TradeOff) -> "Figure":
    """One axis for each wish and one line for each design, coloured by the first wish; drag along axes to select."""
    figure = blank("", "", height=420)
    figure.add_parcoords(
        dimensions=[
            {"label": label(name, unit_of(front, i)), "values": np.asarray(front.values[:, i])}
            for i, name in enumerate(front.names)
        ],
        line={"color": front.values[:, 0], "colorscale": "Cividis"},
        labelfont={"size": SIZE, "family": FONT, "color": INK},
    )
    # Labels stand above the axes, and those of the outer ones reach beyond them.
    return figure.update_layout(margin={"t": 80, "l": 110, "r": 110})


def _told(front: TradeOff, row: "list[float]") -> list[str]:
    each = enumerate(zip(front.names, row, strict=True))
    return [plain(f"{name}: {number(float(one), 5, unit_of(front, i))}") for i, (name, one) in each]


def unit_of(front: TradeOff, which: int) -> str:
    """The unit of a wish; empty where it is unknown."""
    return unit_of_expression(front.wishes[which], front.solutions[0].problem) if front.solutions else ""


def excesses_figure(hardened: Hardened) -> "Figure":
    """The excess of each constraint against the weight of its penalty; one that is zero has no place on the axis."""
    figure = blank(label("Weight of the penalties"), label("Excess over the limit, relative"))
    for name, look in looks(hardened.excesses[0]).items():
        excesses = np.array([one[name] for one in hardened.excesses])
        figure.add_scatter(
            x=list(hardened.weights),
            y=[one if one > 0 else None for one in excesses.tolist()],
            mode="lines+markers",
            name=plain(name),
            line={"color": look.colour, "width": 2},
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            hovertemplate=f"{plain(name)}: %{{y:.2~e}} at weight %{{x:.4~g}}<extra></extra>",
        )
    limit_line(figure, hardened.tolerance, f"accepted: {given(hardened.tolerance)}", logarithmic=True)
    for axis in (figure.update_xaxes, figure.update_yaxes):
        axis(type="log", exponentformat="power", dtick=1)
    return figure.update_layout(showlegend=True)
