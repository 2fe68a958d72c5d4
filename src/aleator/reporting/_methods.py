"""Figures of uncertainty analysis: error against effort, densities against limits, shares as bars."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.reporting._numbers import count, given, number, seconds
from aleator.reporting._style import ALARM, MUTED, SIZE, blank, draw, label, limit_line, looks, padded, plain

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
        texts = [f"{plain(one.name)}: {count(one.calls)} calls, {seconds(one.seconds)}" for one in trials]
        efforts, hover = [getattr(one, by) for one in trials], f"%{{text}}<br>error %{{y:.2e}} {plain(unit)}"
        draw(figure, efforts, [one.error for one in trials], look, name=name, text=texts, hover=hover)
    return figure.update_xaxes(type="log").update_yaxes(type="log")


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
        hover = f"{plain(name)}: %{{y:.3g}} at %{{x:.4g}} {plain(unit)}"
        draw(figure, values, densities[name], look, name=name, mode="lines", hover=hover)
    if densities and len(limits) == 2:
        first = next(iter(densities.values()))
        filled = {"fill": "tozeroy", "fillcolor": ALARM, "opacity": 0.5, "line_width": 0, "showlegend": False}
        for side, limit in zip((-1, 1), limits, strict=True):
            draw(figure, *_beyond(limit, side, values, first), ALARM, mode="lines", **filled)
    for limit in limits:
        limit_line(figure, limit, f"limit {given(limit, unit)}", axis="x")
    above = {"yref": "paper", "y": 0.98, "yanchor": "top", "showarrow": False}
    for text, limit, anchor, shift in zip(tails, limits, ("right", "left"), (-18, 6), strict=False):
        font, written = {"size": SIZE - 1, "color": ALARM}, "<br>".join(map(plain, text.splitlines()))
        figure.add_annotation(x=limit, text=written, xanchor=anchor, xshift=shift, font=font, **above)
    figure.update_xaxes(range=padded([*values[[0, -1]], *limits], 0.02))
    return figure.update_yaxes({"type": "log", "dtick": 2} if logarithmic else {"rangemode": "tozero"})


def _beyond(limit: float, side: int, values: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a density below (`side` -1) or above (1) a limit, which need not be among the values."""
    chosen = values[side * (values - limit) > 0]
    x = np.sort(np.append(chosen, limit)) if chosen.size else chosen
    return x, np.interp(x, values, density)


def _per(unit: str) -> str:
    """The unit of a density over a quantity with this unit."""
    return f"1/({unit})" if any(sign in unit for sign in "/· ") else f"1/{unit}" if unit else ""


def bars_figure(groups: Mapping[str, Mapping[str, float]], *, y: str, unit: str = "") -> "Figure":
    """Grouped bars: one colour for each group, one position for each name."""
    figure = blank("", label(y, unit), height=360)
    for name, look in looks(groups).items():
        shown, hover = groups[name], f"{plain(name)}, %{{x}}: %{{y:.4g}} {plain(unit)}<extra></extra>"
        texts = [number(value, 3) if value % 1 else count(int(value)) for value in shown.values()]
        written = {"text": texts, "textposition": "outside", "cliponaxis": False, "hovertemplate": hover}
        places, color = [plain(one) for one in shown], look.colour
        figure.add_bar(x=places, y=list(shown.values()), name=plain(name), marker_color=color, **written)
    figure.update_layout(barmode="group", bargap=0.35)
    return figure.update_yaxes(rangemode="tozero", linecolor=MUTED)
