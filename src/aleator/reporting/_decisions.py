"""The figure of decisions: where each lies between its bounds."""

from typing import TYPE_CHECKING, Any

import numpy as np

from aleator._core.errors import ProblemError
from aleator.reporting import _units
from aleator.reporting._numbers import given, number
from aleator.reporting._style import LIMIT, MUTED, SIZE, blank, label, looks, plain
from aleator.solution import Solution
from aleator.uncertainty import Decision

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

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
