"""The figure of growing penalties: how they approach the constraints that they stand for."""

from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting._numbers import given
from aleator.reporting._style import blank, label, limit_line, looks, plain
from aleator.sweep import Hardened

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


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
