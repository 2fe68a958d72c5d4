"""Figures of spreads: densities against limits, percentiles, shares that break limits, bars, error against effort."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.reporting._numbers import count, given, number, seconds, share_text
from aleator.reporting._style import (
    ALARM,
    INK,
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

# Between which percentiles each bar reaches, by their places among those sampled, and its width in pixels.
_BARS = ((0, 6, 2, "1 to 99 %"), (1, 5, 7, "5 to 95 %"), (2, 4, 16, "25 to 75 %"))


def percentile_figure(
    sampled: Mapping[str, Sampled], *, x: str, unit: str = "", limit: float | None = None
) -> "Figure":
    """The sampled spread of one quantity for several designs: 1-99 %, 5-95 %, 25-75 %, the median and the mean."""
    figure = blank(label(x, unit), "", height=120 + 64 * len(sampled))
    limits, ends = [] if limit is None else [limit], []
    for row, (name, one) in enumerate(sampled.items()):
        levels, look, rows = one.percentiles, looks(sampled)[name], [plain(name)] * 2
        if levels is None:
            continue
        ends += [levels[0], levels[-1]]
        for low, high, width, text in _BARS:
            hover = f"<b>{rows[0]}</b>, {text}: {number(levels[low])} to {number(levels[high], 4)} {plain(unit)}"
            bar = {"mode": "lines", "hover": hover, "line_width": width, "opacity": 0.55, "showlegend": False}
            draw(figure, [levels[low], levels[high]], rows, look, **bar)
        marks = (("median", levels[3], "line-ns", 16), ("mean", float(one.mean), "circle", 8))
        for text, value, symbol, size in marks:
            hover = f"<b>{rows[0]}</b>, {text}: {number(value)} {plain(unit)}"
            mark = {"marker_size": size, "marker_line_width": 2, "marker_line_color": INK, "showlegend": row == 0}
            named = {"name": text, "legendgroup": text, "mode": "markers", "hover": hover}
            draw(figure, [value], rows[:1], Look(INK, symbol), **named, **mark)
    if limit is not None:
        limit_line(figure, limit, f" limit {given(limit, unit)}", axis="x", upright=True)
    figure.update_xaxes(range=padded([*ends, *limits]))
    return figure.update_yaxes(type="category", range=[len(sampled) - (0.2 if limits else 0.5), -0.5], showgrid=False)


def calibration_figure(calibration: Calibration, *, who: str = "systems") -> "Figure":
    """The violation rate against the margin, with intervals; the target; the chosen margin on fresh samples."""
    y = plain(f"{who.capitalize()} that violate {calibration.name} (%)")
    figure = blank("Margin a (multiples of σ)", y, height=380)
    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    fresh = [] if calibration.confirmation is None else [calibration.confirmation]
    sigmas, shares = [one.sigmas for one in trials], [one.violation for one in trials]
    groups = (
        ("trials, one sample for all", sigmas, shares, Look("#0072b2", "circle"), 8),
        ("the choice, on fresh samples", [calibration.sigmas for _ in fresh], fresh, Look(ALARM, "star"), 14),
    )
    for name, places, each, look, size in groups:
        marks = {"line_width": 1, "line_dash": "dot", "marker_size": size} if len(places) > 1 else {"marker_size": size}
        mode = "markers+lines" if len(places) > 1 else "markers"
        _draw_shares(figure, places, each, look, name=name, mode=mode, hover="a = %{x:.4~g}: %{text}", **marks)
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
        known = [(plain(place), one) for place, one in zip(places, shares[name], strict=True) if one is not None]
        marks = {"mode": "markers", "hover": f"{plain(name)}, %{{x}}: %{{text}}", "cliponaxis": False}
        _draw_shares(figure, [place for place, _ in known], [one for _, one in known], look, name=name, **marks)
    figure.update_layout(showlegend=len(shares) > 1)
    figure.update_xaxes(type="category", categoryorder="array", categoryarray=[plain(place) for place in places])
    return figure.update_yaxes(rangemode="tozero")


def _draw_shares(figure: "Figure", x: Sequence[Any], shares: Sequence[Share], look: Look, **style: Any) -> None:
    """Shares in percent, with their confidence intervals as error bars."""
    y = [100 * one.estimate for one in shares]
    bars = {
        "type": "data",
        "array": [100 * (one.upper - one.estimate) for one in shares],
        "arrayminus": [100 * (one.estimate - one.lower) for one in shares],
        **{"symmetric": False, "color": look.colour, "thickness": 1.5, "width": 4},
    }
    draw(figure, x, y, look, error_y=bars, text=[plain(share_text(one)) for one in shares], **style)


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
