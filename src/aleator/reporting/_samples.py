"""Figures of samples: percentiles, shares of systems with their intervals, the calibration of a margin, magnitudes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aleator.reporting._numbers import given, number, share_text
from aleator.reporting._style import ALARM, INK, Look, blank, draw, label, limit_line, looks, padded, plain
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
    """How many systems, in percent, break each limit at each place, with their intervals; nothing where it is None."""
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
