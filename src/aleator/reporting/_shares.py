"""Figures of shares of systems with their confidence intervals, and of other numbers on a logarithmic axis."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting._numbers import share_text
from aleator.reporting._style import blank, label, limit_line, looks, plain

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from aleator.validation import Share


def shares_figure(
    places: Sequence[str], shares: "Mapping[str, Sequence[Share | None]]", *, x: str = "", y: str
) -> "Figure":
    """How many systems, in percent, break each limit at each place, with their intervals; nothing where it is None."""
    figure = blank(plain(x), label(y, "%"), height=380)
    for name, look in looks(shares).items():
        known = [(place, one) for place, one in zip(places, shares[name], strict=True) if one is not None]
        figure.add_scatter(
            x=[plain(place) for place, _ in known],
            y=[100 * one.estimate for _, one in known],
            error_y={
                "type": "data",
                "symmetric": False,
                "array": [100 * (one.upper - one.estimate) for _, one in known],
                "arrayminus": [100 * (one.estimate - one.lower) for _, one in known],
                "color": look.colour,
                "thickness": 1.5,
                "width": 4,
            },
            mode="markers",
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            name=plain(name),
            text=[plain(share_text(one)) for _, one in known],
            hovertemplate=f"{plain(name)}, %{{x}}: %{{text}}<extra></extra>",
        )
    figure.update_layout(showlegend=len(shares) > 1)
    figure.update_xaxes(type="category", categoryorder="array", categoryarray=[plain(place) for place in places])
    figure.update_yaxes(rangemode="tozero")
    return figure


def magnitudes_figure(
    groups: Mapping[str, Mapping[str, float]], *, y: str, accepted: float, least: float = 1e-16
) -> "Figure":
    """Numbers of very different magnitudes, by name, against the one accepted; what is below `least` is drawn there."""
    figure = blank("", label(y), height=380)
    for name, look in looks(groups).items():
        figure.add_scatter(
            x=[plain(one) for one in groups[name]],
            y=[max(value, least) if np.isfinite(value) else None for value in groups[name].values()],
            mode="markers",
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            name=plain(name),
            text=[f"{value:.1e}" for value in groups[name].values()],
            hovertemplate="%{x}: %{text}<extra></extra>",
        )
    limit_line(figure, accepted, f"accepted: {accepted:.0e}")
    figure.update_layout(showlegend=True)
    figure.update_xaxes(type="category")
    figure.update_yaxes(type="log", exponentformat="power", dtick=2)
    return figure
