"""Figures of spreads: densities against limits, percentiles, shares, bars."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.reporting._numbers import count, given, number, share_text
from aleator.reporting._style import (
    ALARM,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    padded,
    plain,
)
from aleator.sweep import Calibration
from aleator.validation import Sampled, Share

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


def percentile_figure(
    sampled: Mapping[str, Sampled], *, x: str, unit: str = "", limit: float | None = None
) -> "Figure":
    """The sampled spread of one quantity for several designs: 5 to 95 %, 25 to 75 %, the median and the mean."""
    figure = blank(label(x, unit), "", height=120 + 64 * len(sampled))
    for name, look in looks(sampled).items():
        if (levels := sampled[name].percentiles) is not None:
            known = zip(("lowerfence", "q1", "median", "q3", "upperfence"), levels[1:6], strict=True)
            colours = {"line_color": look.colour, "fillcolor": look.fill(0.3), "showlegend": False}
            box = {end: [float(level)] for end, level in known} | {"mean": [float(sampled[name].mean)]} | colours
            figure.add_box(y=[plain(name)], name=plain(name), orientation="h", width=0.4, **box)
    if limit is not None:
        limit_line(figure, limit, f"limit {given(limit, unit)}", axis="x")
    return figure.update_yaxes(type="category", autorange="reversed", showgrid=False)


def calibration_figure(calibration: Calibration, *, who: str = "systems") -> "Figure":
    """The violation rate against the margin, with intervals; the target; the chosen margin on fresh samples."""
    y = plain(f"{who.capitalize()} that violate {calibration.name} (%)")
    figure = blank("Margin a (multiples of σ)", y, height=380)
    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    dotted = {"mode": "markers+lines" if len(trials) > 1 else "markers", "line_width": 1, "line_dash": "dot"}
    sigmas, shares = [one.sigmas for one in trials], [one.violation for one in trials]
    named = {"name": "trials, one sample for all", "marker_size": 8}
    _draw_shares(figure, sigmas, shares, Look("#0072b2", "circle"), **named, **dotted)
    fresh = [] if calibration.confirmation is None else [calibration.confirmation]
    named = {"name": "the choice, on fresh samples", "mode": "markers", "marker_size": 14}
    _draw_shares(figure, [calibration.sigmas] * len(fresh), fresh, Look(ALARM, "star"), **named)
    limit_line(figure, 100 * calibration.target, f"target {given(100 * calibration.target)} %")
    return figure.update_yaxes(rangemode="tozero")


def shares_figure(
    places: Sequence[str], shares: Mapping[str, Sequence[Share | None]], *, x: str = "", y: str
) -> "Figure":
    """How many systems, in percent, break each limit at each place, with their intervals; nothing where it is None.

    Raises `ProblemError` where none is counted.
    """
    if not places or not shares:
        raise ProblemError("plot.violations: expected a limit that single systems can break; received none.")
    figure = blank(plain(x), label(y, "%"), height=380)
    for name, look in looks(shares).items():
        known = {plain(place): one for place, one in zip(places, shares[name], strict=True) if one is not None}
        _draw_shares(figure, [*known], [*known.values()], look, name=name, mode="markers", cliponaxis=False)
    figure.update_layout(showlegend=len(shares) > 1)
    figure.update_xaxes(type="category", categoryorder="array", categoryarray=[plain(place) for place in places])
    return figure.update_yaxes(rangemode="tozero")


def _draw_shares(figure: "Figure", x: Sequence[Any], shares: Sequence[Share], look: Look, **style: Any) -> None:
    """Shares in percent, with their confidence intervals as error bars."""
    bars = {
        "type": "data",
        "array": [100 * (one.upper - one.estimate) for one in shares],
        "arrayminus": [100 * (one.estimate - one.lower) for one in shares],
        **{"symmetric": False, "color": look.colour, "thickness": 1.5, "width": 4},
    }
    over = {"text": [plain(share_text(one)) for one in shares], "hover": "%{text}"}
    draw(figure, x, [100 * one.estimate for one in shares], look, error_y=bars, **over, **style)


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
        draw(figure, values, densities[name], look, name=name, mode="lines")
    if densities and len(limits) == 2:
        first = next(iter(densities.values()))
        filled = {"fill": "tozeroy", "fillcolor": ALARM, "opacity": 0.5, "line_width": 0, "showlegend": False}
        for side, limit in zip((-1, 1), limits, strict=True):
            # The limits need not be among the values.
            beyond = np.sort(np.append(values[side * (values - limit) > 0], limit))
            draw(figure, beyond, np.interp(beyond, values, first), ALARM, mode="lines", hover=None, **filled)
    for limit in limits:
        limit_line(figure, limit, f"limit {given(limit, unit)}", axis="x")
    above = {"yref": "y domain", "y": 0.98, "yanchor": "top", "showarrow": False}
    for text, limit, anchor, shift in zip(tails, limits, ("right", "left"), (-18, 6), strict=False):
        font, written = {"size": SIZE - 1, "color": ALARM}, "<br>".join(map(plain, text.splitlines()))
        figure.add_annotation(x=limit, text=written, xanchor=anchor, xshift=shift, font=font, **above)
    figure.update_xaxes(range=padded([*values[[0, -1]], *limits], 0.02))
    return figure.update_yaxes({"type": "log", "dtick": 2} if logarithmic else {"rangemode": "tozero"})


def _per(unit: str) -> str:
    """The unit of a density over a quantity with this unit."""
    return f"1/({unit})" if any(sign in unit for sign in "/· ") else f"1/{unit}" if unit else ""


def bars_figure(groups: Mapping[str, Mapping[str, float]], *, y: str, unit: str = "") -> "Figure":
    """Grouped bars: one colour for each group, one position for each name."""
    figure = blank("", label(y, unit), height=360)
    for name, look in looks(groups).items():
        shown = groups[name]
        texts = [number(value, 3) if value % 1 else count(int(value)) for value in shown.values()]
        written = {"text": texts, "textposition": "outside", "cliponaxis": False, "marker_color": look.colour}
        figure.add_bar(x=[plain(one) for one in shown], y=[*shown.values()], name=plain(name), **written)
    figure.update_layout(barmode="group", bargap=0.35)
    return figure.update_yaxes(rangemode="tozero", linecolor=MUTED)
