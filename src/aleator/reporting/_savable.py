"""Which results can be saved: by name, nested as needed, with refusals that name the place."""

from collections.abc import Mapping
from typing import Any

from aleator._core.errors import ProblemError
from aleator._core.given import one_of, refusal
from aleator.reporting._datasets import is_own_data
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import Evidence

KINDS = (Solution, Evidence, Front, TradeOff, Calibration)
"""The kinds of results that have labelled arrays."""


def savable(what: str, results: Any) -> tuple[dict[str, Any], list[ProblemError]]:
    """The results that can be saved, and a refusal for each of the others, beginning with `what` and its place."""
    if not isinstance(results, Mapping):
        raise refusal(what, "results by name: a mapping", results)
    kept: dict[str, Any] = {}
    refused: list[ProblemError] = []
    for name, one in results.items():
        place = f"{what}: '{name}'"
        try:
            if isinstance(one, Mapping):
                kept[_name(what, name)], inside = savable(place, one)
                refused += inside
            else:
                kept[_name(what, name)] = _leaf(place, one)
        except ProblemError as error:
            refused.append(error)
    return kept, refused


def _name(what: str, name: Any) -> str:
    """A valid name of a group; `.` and `..` stand for other groups."""
    if not isinstance(name, str | int | float) or str(name) in ("", ".", ".."):
        raise refusal(what, "results by name", name)
    return str(name)


def _leaf(what: str, one: Any) -> Any:
    """A result, or a user's own data in a form that netCDF can hold."""
    if one is None or not is_own_data(one):
        return one if one is None else one_of(what, one, KINDS, "what `solve` gives, or a dataset of xarray")
    import xarray

    try:
        xarray.DataTree.from_dict({"/one": one}).to_netcdf(engine="h5netcdf")
    except (TypeError, ValueError, NotImplementedError) as error:
        raise ProblemError(f"{what}: expected data that netCDF can hold; received other data: {error}") from error
    return one
