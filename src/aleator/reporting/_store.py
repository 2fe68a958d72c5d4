"""Results on disk: labelled arrays as netCDF for programs, designs as JSON for people; and where they come from, by
versions, machine, seeds, times and digests, by which a number can be traced to its run.
"""

import os
import platform
import uuid
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from aleator.reporting._datasets import by_place, leaves, savable, tree
from aleator.reporting._files import write_together
from aleator.reporting._numbers import NOTHING, count, number
from aleator.reporting._page import Block, Section, Table
from aleator.reporting._tables import design_digest, digest, solution_document
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import Evidence

if TYPE_CHECKING:
    import xarray

_LIBRARIES = ("jax", "jaxlib", "equinox", "numpy", "scipy", "casadi", "unopy")
_SIGNED_BY = ("Prepared", "Checked", "Released")


# --- Where numbers come from -----------------------------------------------------------------------------------------


def provenance(results: Mapping[str, Any]) -> Section:
    """The section of a page on where its numbers come from, with lines to sign; empty without results."""
    rows = [row for names, one in leaves(results) for row in _rows(": ".join(names), one)]
    note = (
        "A design's digest changes with its equations, its decisions or its objective, and stands in designs.json as "
        "well. The same seed draws the same systems."
    )
    header = ["Result", "Digest of its design", "Computed by", "Seed", "Seconds"]
    blocks: list[Block] = [
        Table("Results", header, rows, note),
        Table("Program and machine", ["", ""], [[name, said] for name, said in environment().items()]),
        Table("Sign-off", ["", "Name", "Date", "Signature"], [[one, "", "", ""] for one in _SIGNED_BY]),
    ]
    return Section("Where this comes from", blocks if rows else [])


def environment() -> dict[str, str]:
    """The versions and the machine of this process, in words."""
    import aleator

    found = (one for name in _LIBRARIES for one in metadata.distributions(name=name))
    return {
        "aleator": aleator.__version__,
        "Python": f"{platform.python_version()} ({platform.python_implementation()})",
        "Libraries": ", ".join(dict.fromkeys(f"{one.name} {one.version}" for one in found)),
        "Machine": f"{platform.node()}: {platform.system()} {platform.release()}, {platform.machine()}",
        "Processor cores": count(os.cpu_count() or 1),
    }


def _rows(name: str, one: Any) -> Iterator[list[str]]:
    if isinstance(one, Solution):
        yield [name, design_digest(one), one.effort.solver, NOTHING, _seconds(one)]
    elif isinstance(one, Evidence):
        sample = [f"{count(one.samples)} fresh systems", str(one.seed), number(one.seconds, 3)]
        yield [name, design_digest(one.solution), *sample]
    elif isinstance(one, Calibration):
        known = one.evidence
        fresh = [NOTHING] * 2 if known is None else [str(known.seed), number(known.seconds, 3)]
        yield [name, design_digest(one.solution), f"{count(len(one.trials))} trials", *fresh]
    elif isinstance(one, Front | TradeOff) and one.solutions:
        together = digest("".join(map(design_digest, one.solutions)).encode())
        solvers = ", ".join(dict.fromkeys(each.effort.solver for each in one.solutions))
        yield [name, together, f"{count(len(one.solutions))} designs: {solvers}", NOTHING, _seconds(*one.solutions)]


def _seconds(*solutions: Solution) -> str:
    """How long solves took, with their compilations."""
    return number(sum(one.effort.times.compile_ + one.effort.times.solve for one in solutions), 3)


# --- Files -----------------------------------------------------------------------------------------------------------


Result: TypeAlias = "Solution | Evidence | Front | TradeOff | Calibration | xarray.Dataset"

PAGE = "report.html"
"""The page of a study, beside its results."""

_RESULTS, _DESIGNS = "results.nc", "designs.json"


def save(folder: str | Path, /, **results: "Result | Mapping[str, Any] | None") -> tuple[Path, ...]:
    """Write results into a folder and return the paths: `results.nc`, and `designs.json` if there is a solution.

    Each keyword is a result, a dataset, or a mapping of these by name, nested as needed: a group of the netCDF file.
    Solutions become entries of the JSON file, with the violations in their evidence. Both files always belong to the
    same call, and carry a common identifier; files of an earlier run are kept until the new ones are complete.

    Raises `ProblemError` for anything that is not a result, naming its place, if the folder cannot be written to, or if
    another process keeps writing into it.
    """
    kept, refused = savable("save", results)
    if refused:
        raise refused[0]
    return _write(folder, kept)


def save_study(folder: Path, results: Mapping[str, Any]) -> tuple[Path, ...]:
    """Write results that are `savable`, and remove an earlier page, which would show other numbers."""
    return _write(folder, results, {PAGE: None})


def _write(
    folder: str | Path, results: Mapping[str, Any], outdated: Mapping[str, None] | None = None
) -> tuple[Path, ...]:
    """Write one set of results, and remove outdated files with the earlier set."""
    generation, nodes = uuid.uuid4().hex, tree(results)
    nodes.attrs |= {"generation": generation, **environment()}
    document = {place: {**one, "generation": generation} for place, one in designs_document(results).items()}
    files = {
        # In memory, since on a full disk HDF5 fails to close its file and ends the process.
        _RESULTS: bytes(nodes.to_netcdf(engine="h5netcdf")),
        _DESIGNS: json_text(document).encode("utf-8") if document else None,
    }
    return write_together(folder, {**files, **(outdated or {})})


def json_text(document: Any) -> str:
    """Strict, readable JSON: non-finite numbers become null."""
    from pydantic_core import to_json

    return to_json(document, indent=2, inf_nan_mode="null", fallback=_in_python).decode() + "\n"


def _in_python(value: Any) -> Any:
    """A mapping, or an array or a number of NumPy's or JAX's, in Python's own types."""
    return dict(value) if isinstance(value, Mapping) else np.asarray(value).tolist()


def designs_document(results: Mapping[str, Any]) -> dict[str, Any]:
    """Every solution among the results by its place, in human-readable form."""
    found = by_place(results)
    judged = {id(one.solution): one for one in found.values() if isinstance(one, Evidence)}
    return {
        place: solution_document(one, judged.get(id(one))) for place, one in found.items() if isinstance(one, Solution)
    }
