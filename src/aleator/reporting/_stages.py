"""The paths of designs that a reader chooses on a page: one figure for all of them, and the numbers of each."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator.reporting._blocks import Band, Linked, Table
from aleator.reporting._paths import path_figure
from aleator.reporting._style import padded, plain
from aleator.solution import Moments

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# A band is written to this part of the range of its figure, finer than a pixel.
_FINE = 2000


def stages(block: Linked) -> "dict[str, Figure]":
    """A figure for each path of the choices, by its name, as the first choice that has it; all on the same axes."""
    return {name: _stage(bands) for name, bands in _by_name(block).items()}


def choices_data(block: Linked) -> dict[str, Any]:
    """Names, facts and paths of the choices, as JSON."""
    grouped = _by_name(block)
    digits = {name: _digits(_reached(bands)) for name, bands in grouped.items()}
    seconds = {name: _digits([edge for one in bands for edge in _ends(one.times)]) for name, bands in grouped.items()}
    return {
        "paths": list(grouped),
        "choices": [
            {
                "name": one.name,
                "facts": [_table(table) for table in one.facts],
                "bands": {band.name: _numbers(band, digits[band.name], seconds[band.name]) for band in one.bands},
            }
            for one in block.choices
        ],
    }


def _by_name(block: Linked) -> dict[str, list[Band]]:
    """The bands of all choices by the names of their paths."""
    every = [band for one in block.choices for band in one.bands]
    return {name: [one for one in every if one.name == name] for name in dict.fromkeys(one.name for one in every)}


def _stage(bands: Sequence[Band]) -> "Figure":
    first = bands[0]
    figure = path_figure(
        first.times,
        {f"mean of {first.name}": Moments(first.mean, first.std)},
        sigmas=first.sigmas,
        y=first.name,
        unit=first.unit,
        limits=first.limits,
    )
    figure.update_layout(height=300)
    figure.update_xaxes(range=[min(one.times.min() for one in bands), max(one.times.max() for one in bands)])
    return figure.update_yaxes(range=padded(_reached(bands), 0.1))


def _reached(bands: Sequence[Band]) -> list[float]:
    """The ends of all bands, and their limits."""
    edges = [edge for one in bands for sign in (-1, 1) for edge in _ends(one.mean + sign * one.sigmas * one.std)]
    return [*edges, *(value for one in bands for value in one.limits)]


def _ends(values: np.ndarray) -> list[float]:
    """The least and the largest of the finite values."""
    known = values[np.isfinite(values)]
    return [float(known.min()), float(known.max())] if known.size else []


def _digits(values: Sequence[float]) -> int:
    """The decimals by which a figure that reaches over these values is drawn exactly."""
    wide = max(values, default=1.0) - min(values, default=0.0)
    return math.ceil(-math.log10(wide / _FINE)) if wide > 0 else 6


def _numbers(band: Band, digits: int, seconds: int) -> dict[str, Any]:
    return {
        "times": _rounded(band.times, seconds),
        "mean": _rounded(band.mean, digits),
        # One digit more: it is multiplied.
        "std": _rounded(band.std, digits + 1),
        "sigmas": band.sigmas,
        "limits": [[value, plain(text)] for value, text in band.limits.items()],
    }


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    """Numbers as JSON, without a fraction where they have none; null where one is not finite."""
    rounded = (round(float(one), digits) if math.isfinite(one) else None for one in values)
    return [int(one) if one is not None and one.is_integer() else one for one in rounded]


def _table(table: Table) -> dict[str, Any]:
    return {"caption": table.caption, "rows": [list(row) for row in table.rows], "note": table.note}
