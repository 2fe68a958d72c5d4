"""Figures of evidence: trajectories, percentiles, shares of systems, the calibration of a margin; and of signals."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.reporting._numbers import given, number, share_text
from aleator.reporting._style import ALARM, INK, blank, label, limit_line, looks, padded, plain, short
from aleator.sweep import Calibration
from aleator.validation import Evidence, Sampled, Share, Trajectories

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

DRAWN, EVERY = 60, 4


def signal_figure(
    times: np.ndarray, values: np.ndarray, *, name: str, unit: str = "", x: str = "Time", x_unit: str = "s"
) -> "Figure":
    """An input over time (figure 6.2)."""
    figure = blank(label(x, x_unit), label(name, unit), height=300)
    figure.add_scatter(
        x=short(times),
        y=short(values),
        mode="lines",
        line={"color": "#0072b2", "width": 1.5},
        name=plain(name),
        hovertemplate=f"%{{y:.4~g}} {plain(unit)} at %{{x:.3f}} {plain(x_unit)}<extra></extra>",
    )
    return figure


def trajectory_figure(
    evidence: Evidence,
    name: str,
    *,
    y: str = "",
    unit: str = "",
    who: str = "systems",
    drawn: int = DRAWN,
    every: int = EVERY,
) -> "Figure":
    """Sampled systems over time against the bounds of the constraints called `name` (figures 6.9 and 6.10).

    Those that violate any of them are highlighted. The title gives the proportion over all samples.
    """
    share = evidence.violations.get(name)
    title = "" if share is None else f"{share_text(share)} of {plain(who)} violate"
    figure = blank(label("Time", "s"), label(y or name, unit), title=title, height=380)
    kept = [one for one in evidence.trajectories if one.name == name]
    times = evidence.solution.instants[::every]
    distinct = _distinct(kept)
    for one, first in zip(distinct, [True] + [False] * len(distinct), strict=False):
        rows, broken = curves(one.values[:drawn, ::every], one.violating[:drawn])
        inside, outside = rows[~broken], rows[broken]
        add_lines(
            figure, times, inside, f"within the limits ({len(inside)} of {len(rows)} drawn)", "#a9b4bf", 0.8, first
        )
        add_lines(figure, times, outside, f"violating ({len(outside)} of {len(rows)} drawn)", ALARM, 0.9, first)
    for bound in dict.fromkeys(value for one in kept for value in (one.upper, one.lower) if np.isfinite(value)):
        limit_line(figure, bound, f"limit {given(bound, unit)}")
    if kept:
        bounds = [value for one in kept for value in (one.upper, one.lower) if np.isfinite(value)]
        extremes = [edge(one.values[:drawn]) for one in kept for edge in (np.min, np.max)]
        figure.update_yaxes(range=padded([*extremes, *bounds], 0.1))
    return figure


def curves(values: np.ndarray, violating: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One row per curve, and whether its system violates; a vector over time gives one curve per component."""
    broken = np.asarray(violating, dtype=bool)
    if values.ndim == 2:
        return values, broken
    flat = values.reshape(*values.shape[:2], -1)
    return np.moveaxis(flat, 2, 1).reshape(-1, values.shape[1]), np.repeat(broken, flat.shape[2])


def _distinct(kept: list[Trajectories]) -> list[Trajectories]:
    """Without repeated values, since both sides of a pair of bounds measure the same quantity."""
    found: list[Trajectories] = []
    for one in kept:
        if not any(np.array_equal(one.values, other.values) for other in found):
            found.append(one)
    return found


def add_lines(
    figure: "Figure", times: np.ndarray, rows: np.ndarray, name: str, colour: str, width: float, legend: bool
) -> None:
    """Many curves as one trace, separated by gaps."""
    if not len(rows):
        return
    if legend:
        # Thick enough for its colour to be seen.
        figure.add_scatter(x=[None], y=[None], mode="lines", name=name, line={"color": colour, "width": 4})
    gap = np.full((len(rows), 1), np.nan)
    figure.add_scatter(
        x=short(np.hstack([np.tile(times, (len(rows), 1)), gap]).ravel()),
        y=short(np.hstack([rows.reshape(len(rows), -1), gap]).ravel()),
        mode="lines",
        name=name,
        showlegend=False,
        line={"color": colour, "width": width},
        opacity=0.7,
        hoverinfo="skip",
        connectgaps=False,
    )


def percentile_figure(
    sampled: Mapping[str, Sampled], *, x: str, unit: str = "", limit: float | None = None
) -> "Figure":
    """The sampled spread of one quantity for several designs: 1-99 %, 5-95 %, 25-75 %, the median and the mean."""
    figure = blank(label(x, unit), "", height=120 + 64 * len(sampled))
    bars = ((0, 6, 2, "1 to 99 %"), (1, 5, 7, "5 to 95 %"), (2, 4, 16, "25 to 75 %"))
    for row, (name, one) in enumerate(sampled.items()):
        levels, look = one.percentiles, looks(sampled)[name]
        if levels is None:
            continue
        for low, high, width, text in bars:
            figure.add_scatter(
                x=[levels[low], levels[high]],
                y=[plain(name)] * 2,
                mode="lines",
                line={"color": look.colour, "width": width},
                opacity=0.55,
                showlegend=False,
                hovertemplate=(
                    f"<b>{plain(name)}</b>, {text}: {number(levels[low])} to {number(levels[high], 4)}"
                    f" {plain(unit)}<extra></extra>"
                ),
            )
        for value, symbol, text in ((levels[3], "line-ns", "median"), (float(one.mean), "circle", "mean")):
            figure.add_scatter(
                x=[value],
                y=[plain(name)],
                mode="markers",
                name=text,
                legendgroup=text,
                showlegend=row == 0,
                marker={
                    "symbol": symbol,
                    "size": 16 if text == "median" else 8,
                    "color": INK,
                    "line": {"width": 2, "color": INK},
                },
                hovertemplate=f"<b>{plain(name)}</b>, {text}: {number(value)} {plain(unit)}<extra></extra>",
            )
    if limit is not None:
        limit_line(figure, limit, f" limit {given(limit, unit)}", axis="x", upright=True)
    ends = [one.percentiles[i] for one in sampled.values() if one.percentiles is not None for i in (0, -1)]
    figure.update_xaxes(range=padded([*ends, *([] if limit is None else [limit])]))
    figure.update_yaxes(
        type="category", range=[len(sampled) - (0.2 if limit is not None else 0.5), -0.5], showgrid=False
    )
    return figure


def calibration_figure(calibration: Calibration, *, who: str = "systems") -> "Figure":
    """The violation rate against the margin, with intervals; the target; the chosen margin on fresh samples."""
    figure = blank(
        "Margin a (multiples of σ)", plain(f"{who.capitalize()} that violate {calibration.name} (%)"), height=380
    )
    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    fresh = [] if calibration.confirmation is None else [calibration.confirmation]
    groups = (
        (
            "trials, one sample for all",
            [one.sigmas for one in trials],
            [one.violation for one in trials],
            "#0072b2",
            "circle",
        ),
        ("the choice, on fresh samples", [calibration.sigmas for _ in fresh], fresh, ALARM, "star"),
    )
    for name, sigmas, shares, colour, symbol in groups:
        figure.add_scatter(
            x=sigmas,
            y=[100 * one.estimate for one in shares],
            error_y=_intervals(shares, colour),
            mode="markers+lines" if len(sigmas) > 1 else "markers",
            line={"color": colour, "width": 1, "dash": "dot"},
            marker={"color": colour, "symbol": symbol, "size": 8 if symbol == "circle" else 14},
            name=name,
            text=[share_text(one) for one in shares],
            hovertemplate="a = %{x:.4~g}: %{text}<extra></extra>",
        )
    limit_line(figure, 100 * calibration.target, f"target {given(100 * calibration.target)} %")
    figure.update_yaxes(rangemode="tozero")
    return figure


def shares_figure(
    places: Sequence[str], shares: Mapping[str, Sequence[Share | None]], *, x: str = "", y: str
) -> "Figure":
    """How many systems, in percent, break each limit at each place, with their intervals; nothing where it is None."""
    figure = blank(plain(x), label(y, "%"), height=380)
    for name, look in looks(shares).items():
        known = [(place, one) for place, one in zip(places, shares[name], strict=True) if one is not None]
        figure.add_scatter(
            x=[plain(place) for place, _ in known],
            y=[100 * one.estimate for _, one in known],
            error_y=_intervals([one for _, one in known], look.colour),
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


def _intervals(shares: Sequence[Share], colour: str) -> dict[str, Any]:
    """The confidence intervals of some shares, in percent, as error bars."""
    return {
        "type": "data",
        "symmetric": False,
        "array": [100 * (one.upper - one.estimate) for one in shares],
        "arrayminus": [100 * (one.estimate - one.lower) for one in shares],
        "color": colour,
        "thickness": 1.5,
        "width": 4,
    }
