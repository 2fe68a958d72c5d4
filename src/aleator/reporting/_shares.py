"""Figures of shares of systems with their confidence intervals, and of other numbers on a logarithmic axis."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from aleator.reporting._numbers import given, share_text
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
            cliponaxis=False,
            name=plain(name),
            text=[plain(share_text(one)) for _, one in known],
            hovertemplate=f"{plain(name)}, %{{x}}: %{{text}}<extra></extra>",
        )
    figure.update_layout(showlegend=len(shares) > 1)
    figure.update_xaxes(type="category", categoryorder="array", categoryarray=[plain(place) for place in places])
    figure.update_yaxes(rangemode="tozero")
    return figure


def magnitudes_figure(
    groups: Mapping[str, Mapping[str, float]], *, x: str, accepted: float, least: float = 1e-16
) -> "Figure":
    """Numbers of very different magnitudes, a row for each, against the one accepted; those below `least` lie there."""
    names = [plain(name) for group in groups.values() for name in group]
    figure = blank(label(x), "", height=130 + 34 * len(names))
    for kind, look in looks(groups).items():
        values = groups[kind]
        figure.add_scatter(
            x=[max(one, least) if np.isfinite(one) else None for one in values.values()],
            y=[plain(name) for name in values],
            mode="markers",
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            name=plain(kind),
            text=[f"{one:.1e}" for one in values.values()],
            hovertemplate="%{y}: %{text}<extra></extra>",
        )
    limit_line(figure, accepted, f"accepted: {given(accepted)}", axis="x", logarithmic=True)
    figure.update_layout(showlegend=True)
    figure.update_xaxes(type="log", exponentformat="power", dtick=2)
    figure.update_yaxes(type="category", range=[len(names) - 0.5, -0.5])
    return figure
