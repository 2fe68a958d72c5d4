"""Figures of paths: their mean with a band over time, and the histories of many realisations."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from aleator.reporting._boxes import DASHES
from aleator.reporting._numbers import given
from aleator.reporting._samples import DRAWN, add_lines, curves
from aleator.reporting._style import add_band, blank, label, limit_line, looks, padded, plain, short
from aleator.solution import Moments

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_CLOUD = "#a9b4bf"


def path_figure(
    times: Float[np.ndarray, " instants"],
    paths: Mapping[str, Moments],
    *,
    sigmas: float,
    y: str,
    unit: str = "",
    histories: Float[np.ndarray, "systems instants ..."] | None = None,
    limits: Mapping[float, str] | None = None,
    title: str = "",
) -> "Figure":
    """The mean of each path, of shape (instants,), with the band of `sigmas` standard deviations about it.

    - `histories`: of some systems, of which the first 60 are drawn behind; `limits`: drawn as lines, with their names.
    """
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    behind = np.zeros((0, len(times))) if histories is None else histories[:DRAWN]
    rows = curves(behind, np.zeros(len(behind), dtype=bool))[0]
    add_lines(figure, times, rows, f"{len(behind)} systems", _CLOUD, 0.8, True)
    styles = looks(paths)
    for name, one in paths.items():
        if np.any(one.std):
            add_band(figure, times, one.mean - sigmas * one.std, one.mean + sigmas * one.std, styles[name].fill(0.25))
    for dash, (name, one) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        spread = f" ± {sigmas:.3g} σ" if np.any(one.std) else ""
        figure.add_scatter(
            x=short(times),
            y=short(one.mean),
            customdata=short(one.std),
            mode="lines",
            name=plain(f"{name}{spread}"),
            line={"color": styles[name].colour, "width": 2, "dash": dash},
            hovertemplate=(
                f"{plain(name)}: %{{y:.4~g}}, σ %{{customdata:.2~g}} {plain(unit)} at %{{x:.3f}} s<extra></extra>"
            ),
        )
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text, under=bound < 0)
    ends = [edge for one in paths.values() for edge in _ends(one.mean - sigmas * one.std, one.mean + sigmas * one.std)]
    figure.update_layout(showlegend=True)
    figure.update_yaxes(range=padded([*ends, *_ends(rows), *(limits or {})], 0.1))
    return figure


def histories_figure(
    times: Float[np.ndarray, " instants"],
    histories: Float[np.ndarray, "systems instants ..."],
    *,
    y: str,
    unit: str = "",
    who: str = "systems",
    limits: Mapping[float, str] | None = None,
    title: str = "",
) -> "Figure":
    """The histories of some realisations, one line for each; of a vector, one for each component too."""
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    rows, look = curves(histories, np.zeros(len(histories), dtype=bool))[0], looks([y])[y]
    told = f"{len(histories)} {who if len(histories) != 1 else who.removesuffix('s')}"
    add_lines(figure, times, rows, plain(told), look.colour, 0.8 if len(rows) > 1 else 2.0, True)
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text, under=bound < 0)
    figure.update_layout(showlegend=True)
    figure.update_yaxes(range=padded([*_ends(rows), *(limits or {})], 0.1))
    return figure


def limits_text(bounds: Sequence[float], unit: str) -> dict[float, str]:
    """The text of each finite limit."""
    return {bound: f"limit {given(bound, unit)}" for bound in dict.fromkeys(bounds) if np.isfinite(bound)}


def _ends(*values: np.ndarray) -> Iterator[float]:
    """The least and the largest of the finite values."""
    for one in values:
        known = one[np.isfinite(one)]
        if known.size:
            yield float(known.min())
            yield float(known.max())
