"""Figures of uncertainty analysis: error against effort, densities against limits, shares as bars."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.reporting._numbers import count, given, number, seconds
from aleator.reporting._style import ALARM, MUTED, SIZE, blank, label, limit_line, looks, padded, plain

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


class Trial(NamedTuple):
    """One result of a method: its effort in model calls and in wall time (s), and its error."""

    name: str
    calls: int
    seconds: float
    error: float


def effort_figure(methods: Mapping[str, Sequence[Trial]], *, error: str, unit: str = "", by: str = "calls") -> "Figure":
    """The error of methods against their effort, on logarithmic axes: `by` is `calls` or `seconds`."""
    axis = {"calls": label("Model calls"), "seconds": label("Wall time", "s")}[by]
    figure = blank(axis, label(error, unit))
    for name, look in looks(methods).items():
        trials = [one for one in methods[name] if one.error > 0]
        figure.add_scatter(
            x=[getattr(one, by) for one in trials],
            y=[one.error for one in trials],
            mode="lines+markers",
            name=plain(name),
            line={"color": look.colour, "width": 2},
            marker={"symbol": look.symbol, "size": 9, "color": look.colour},
            text=[f"{plain(one.name)}: {count(one.calls)} calls, {seconds(one.seconds)}" for one in trials],
            hovertemplate=f"%{{text}}<br>error %{{y:.2e}} {plain(unit)}<extra></extra>",
        )
    figure.update_xaxes(type="log", exponentformat="power")
    figure.update_yaxes(type="log", exponentformat="power")
    return figure


def density_figure(
    values: Float[np.ndarray, " n"],
    densities: Mapping[str, Float[np.ndarray, " n"]],
    *,
    x: str,
    unit: str = "",
    limits: Sequence[float] = (),
    tails: Sequence[str] = (),
    logarithmic: bool = False,
    title: str = "",
) -> "Figure":
    """Probability densities of one quantity against its limits; the area beyond them is filled.

    `tails` are the probabilities below and above the limits. Tails too thin to be seen show on a `logarithmic` axis.
    """
    figure = blank(label(x, unit), label("Density", _per(unit)), title=title, height=380)
    for name, look in looks(densities).items():
        figure.add_scatter(
            x=values,
            y=densities[name],
            mode="lines",
            name=plain(name),
            line={"color": look.colour, "width": 2},
            hovertemplate=f"{plain(name)}: %{{y:.3g}} at %{{x:.4g}} {plain(unit)}<extra></extra>",
        )
    if densities and len(limits) == 2:
        first = next(iter(densities.values()))
        for side, limit in zip((-1, 1), limits, strict=True):
            x_beyond, y_beyond = _beyond(limit, side, values, first)
            figure.add_scatter(
                x=x_beyond,
                y=y_beyond,
                mode="lines",
                line={"width": 0},
                fill="tozeroy",
                fillcolor=ALARM,
                opacity=0.5,
                showlegend=False,
                hoverinfo="skip",
            )
    for limit in limits:
        limit_line(figure, limit, f"limit {given(limit, unit)}", axis="x")
    figure.update_xaxes(range=padded([*values[[0, -1]], *limits], 0.02))
    if logarithmic:
        figure.update_yaxes(type="log", exponentformat="power", dtick=2)
    else:
        figure.update_yaxes(rangemode="tozero")
    for text, limit, anchor in zip(tails, limits, ("right", "left"), strict=False):
        figure.add_annotation(
            text="<br>".join(map(plain, text.splitlines())),
            x=limit,
            xanchor=anchor,
            xshift={"right": -18, "left": 6}[anchor],
            yref="paper",
            y=0.98,
            yanchor="top",
            showarrow=False,
            font={"size": SIZE - 1, "color": ALARM},
        )
    return figure


def _beyond(limit: float, side: int, values: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a density below (`side` -1) or above (1) a limit, which need not be among the values."""
    chosen = side * (values - limit) > 0
    if not chosen.any():
        return values[chosen], density[chosen]
    place = 0 if side > 0 else int(chosen.sum())
    return (
        np.insert(values[chosen], place, limit),
        np.insert(density[chosen], place, np.interp(limit, values, density)),
    )


def _per(unit: str) -> str:
    """The unit of a density over a quantity with this unit."""
    return f"1/({unit})" if any(sign in unit for sign in "/· ") else f"1/{unit}" if unit else ""


def bars_figure(groups: Mapping[str, Mapping[str, float]], *, y: str, unit: str = "") -> "Figure":
    """Grouped bars: one colour for each group, one position for each name."""
    figure = blank("", label(y, unit), height=360)
    for name, look in looks(groups).items():
        shown = groups[name]
        figure.add_bar(
            x=[plain(one) for one in shown],
            y=list(shown.values()),
            name=plain(name),
            marker={"color": look.colour},
            text=[number(value, 3) if value % 1 else count(int(value)) for value in shown.values()],
            textposition="outside",
            cliponaxis=False,
            hovertemplate=f"{plain(name)}, %{{x}}: %{{y:.4g}} {plain(unit)}<extra></extra>",
        )
    figure.update_layout(barmode="group", bargap=0.35)
    figure.update_yaxes(rangemode="tozero", linecolor=MUTED)
    return figure
