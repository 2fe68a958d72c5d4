"""Figures of fronts along a bound, with the names and the units of their problem."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting import _units
from aleator.reporting._fronts import front_figure, shadow_price_figure
from aleator.reporting._ordered import ordered
from aleator.reporting._style import blank, label, looks, plain
from aleator.sweep import Front

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def optimum_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The optimum along one bound, for some fronts by name, with the units of their problem."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), _units.of_expression(problem.objective, problem)
    return front_figure(fronts, y="Objective", y_unit=y_unit, x=f"Limit of {front.bound}", x_unit=x_unit)


def price_figure(fronts: Mapping[str, Front]) -> "Figure":
    """The shadow price of one bound along it, for some fronts by name, with its unit."""
    front = next(iter(fronts.values()))
    problem = front.solutions[0].problem
    x_unit, y_unit = bound_unit(front), _units.of_expression(problem.objective, problem)
    per = f"{y_unit or '1'} per {x_unit}" if x_unit else ""
    x = f"Limit of {front.bound}"
    return shadow_price_figure(fronts, y="Shadow price of the bound", y_unit=per, x=x, x_unit=x_unit)


def bound_unit(front: Front) -> str:
    """The unit of the bound along which a front lies."""
    problem = front.solutions[0].problem
    return _units.of_expression(problem.named(front.bound)[0].expression, problem)


def decision_figure(front: Front, name: str) -> "Figure":
    """A decision along the bound of a front, of an array each entry; gaps where there is no design."""
    front, problem = ordered(front), front.solutions[0].problem
    unit = _units.of_decision(name, problem)
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
