"""The figure of a search without derivatives: what it evaluated, and its best point so far."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from aleator.nlp import Searched
from aleator.reporting import _units
from aleator.reporting._blocks import Drawing
from aleator.reporting._style import ALARM, MUTED, blank, label, looks, padded, plain, short
from aleator.solution import Solution

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

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
            figure = search_figure(searched, _units.of_expression(one.problem.objective, one.problem))
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
