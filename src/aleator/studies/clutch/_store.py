"""The clutch study's results other than designs, as labelled arrays for its file of results."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator.studies.clutch._counts import Counts
from aleator.studies.clutch._run import Method

if TYPE_CHECKING:
    import xarray


def methods_dataset(methods: Sequence[Method]) -> "xarray.Dataset":
    """The rows of table 7.2 and of its extension."""
    import xarray

    errors = [np.nan if one.standard_error is None else one.standard_error for one in methods]
    return xarray.Dataset(
        {
            "three_sigma": ("row", [one.variation for one in methods], {"units": "degree"}),
            "standard_error": ("row", errors, {"units": "degree"}),
            "points": ("row", [one.points for one in methods], {"units": "1"}),
            "seconds": ("row", [one.seconds for one in methods], {"units": "s"}),
        },
        coords={"row": [one.name for one in methods]},
    )


def analysis_dataset(one: al.results.ToleranceAnalysis) -> "xarray.Dataset":
    """The tolerance analysis for one specification, and the contributions of the dimensions."""
    import xarray

    angles = ("nominal", "mean", "std", "lower", "upper", "rss", "linear_std")
    numbers = {name: ((), getattr(one, name), {"units": "degree"}) for name in angles}
    numbers |= {name: ((), getattr(one, name), {"units": "1"}) for name in ("skewness", "kurtosis", "cp", "cpk")}
    numbers |= {name: ((), getattr(one, name), {"units": "ppm"}) for name in ("rejects_low", "rejects_high")}
    parts = one.contributions.values()
    shares = {
        "linear_share": ("dimension", [part.linear for part in parts], {"units": "percent"}),
        "total_share": ("dimension", [part.total for part in parts], {"units": "percent"}),
    }
    return xarray.Dataset(numbers | shares, coords={"dimension": list(one.contributions)})


def counts_dataset(counts: Mapping[str, Counts]) -> "xarray.Dataset":
    """Rejects counted, and the exact worst case, of each set of tolerances."""
    import xarray

    every = list(counts.values())
    rejected = [[one.by_name[spec].either.count for spec in ("limits", "deviation")] for one in every]
    return xarray.Dataset(
        {
            "rejects": (("tolerances", "specification"), rejected, {"units": "1"}),
            "assemblies": ("tolerances", [one.function.low.samples for one in every], {"units": "1"}),
            "worst_case": (("tolerances", "end"), [list(one.worst_case) for one in every], {"units": "degree"}),
            "tolerance": (
                ("tolerances", "dimension"),
                [list(one.tolerances.values()) for one in every],
                {"units": "mm"},
            ),
        },
        coords={
            "tolerances": list(counts),
            "specification": ["limits", "deviation"],
            "end": ["least", "largest"],
            "dimension": list(every[0].tolerances),
        },
    )
