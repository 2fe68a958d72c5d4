"""Results on disk: labelled arrays as netCDF for programs, designs as JSON for people."""

import json
import math
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from aleator.reporting import _units
from aleator.reporting._datasets import by_place, savable, tree
from aleator.reporting._files import write_together
from aleator.reporting._provenance import design_digest, environment
from aleator.solution import ConstraintResult, Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import Evidence, Proportion

if TYPE_CHECKING:
    import xarray

Result: TypeAlias = "Solution | Evidence | Front | TradeOff | Calibration | xarray.Dataset"

PAGE = "report.html"
"""The page of a study, beside its results."""


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
    return _write(folder, kept, ())


def save_study(folder: str | Path, results: Mapping[str, Any]) -> tuple[Path, ...]:
    """Write results that are `savable`, and remove an earlier page, which would show other numbers."""
    return _write(folder, results, (PAGE,))


def _write(folder: str | Path, results: Mapping[str, Any], outdated: Sequence[str]) -> tuple[Path, ...]:
    """Write one set of results, and remove outdated files with the earlier set."""
    generation = uuid.uuid4().hex
    nodes = tree(results)
    nodes.attrs |= {"generation": generation, **environment()}
    document = {place: {**one, "generation": generation} for place, one in designs_document(results).items()}
    files = {
        # In memory, since on a full disk HDF5 fails to close its file and ends the process.
        "results.nc": bytes(nodes.to_netcdf(engine="h5netcdf")),
        "designs.json": json_text(document).encode("utf-8") if document else None,
    }
    return write_together(folder, {**files, **dict.fromkeys(outdated)})


def json_text(document: Any) -> str:
    """Strict, readable JSON: non-finite numbers become null."""
    return json.dumps(strict(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def strict(value: Any) -> Any:
    """A value in JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): strict(one) for key, one in value.items()}
    if isinstance(value, np.ndarray):
        return strict(value.tolist())
    if isinstance(value, list | tuple):
        return [strict(one) for one in value]
    if isinstance(value, np.generic):
        return strict(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return strict(np.asarray(value))


def designs_document(results: Mapping[str, Any]) -> dict[str, Any]:
    """Every solution among the results by its place, in human-readable form."""
    found = by_place(results)
    judged = {id(one.solution): one for one in found.values() if isinstance(one, Evidence)}
    return {
        place: solution_document(one, judged.get(id(one))) for place, one in found.items() if isinstance(one, Solution)
    }


def solution_document(solution: Solution, evidence: Evidence | None = None) -> dict[str, Any]:
    """One design: decisions, objective, constraints, certificate and, where it was sampled, violations."""
    problem, quality = solution.problem, solution.certificate.expansion
    document: dict[str, Any] = {
        "status": solution.status.value,
        "decisions": {
            name: {
                "value": value,
                "unit": _units.of_decision(name, problem),
                "multiplier": solution.bound_multipliers.get(name),
                "at_bound": solution.is_at_bound(name),
            }
            for name, value in solution.decisions.items()
        },
        "objective": {
            "value": solution.objective,
            "unit": _units.of_expression(problem.objective, problem),
            "expression": str(problem.objective),
        },
        "active": solution.active,
        "constraints": [
            _constraint(one, _units.of_expression(declared.expression, problem))
            for one, declared in zip(solution.constraints, problem.constraints, strict=True)
        ],
        "certificate": {
            "violation": solution.certificate.violation,
            "stationarity": solution.certificate.stationarity,
            "complementarity": solution.certificate.complementarity,
            "iterations": solution.effort.iterations,
            "evaluations": solution.effort.evaluations,
            "solver": solution.effort.solver,
            "search": None if solution.effort.searched is None else str(solution.effort.searched),
            "message": solution.message,
            "said": [f"{label}: {text}" for label, text in solution.certificate.rows()],
        },
        "meshes": [str(one) for one in solution.meshes],
        "expansion": {
            "order": quality.order,
            "terms": quality.terms,
            "points": quality.points,
            "condition_number": quality.condition_number,
            "leave_one_out": quality.leave_one_out,
            "leave_one_out_of_derivatives": quality.tangents,
        },
        "seconds": {"compile": solution.effort.times.compile_, "solve": solution.effort.times.solve},
        "digest": design_digest(solution),
        "problem": solution.problem_text.splitlines(),
    }
    if not solution.ok:
        document["why"] = solution.why()
    if evidence is not None:
        document["evidence"] = evidence_document(evidence)
    return document


def evidence_document(evidence: Evidence) -> dict[str, Any]:
    """Evidence on one design: the share of fresh systems that break each limit, with its interval."""
    shares = {name: _share(one) for name, one in evidence.violations.items()}
    return {
        "samples": evidence.samples,
        "seed": evidence.seed,
        "instants": evidence.instants,
        "agrees": evidence.agrees,
        "disagreements": [one.sentence() for one in evidence.disagreements],
        "compared": [one.sentence() for one in evidence.compared],
        "violations": {**shares, "any": _share(evidence.joint)},
    }


def _constraint(one: ConstraintResult, unit: str) -> dict[str, Any]:
    """A constraint at its worst instant; histories are in the netCDF file."""
    return {
        "name": one.name,
        "text": one.text,
        "unit": unit,
        "lower": one.lower,
        "upper": one.upper,
        "worst_value": one.worst,
        "worst_time_s": one.worst_time,
        "violation": one.violation,
        "active": bool(np.any(one.active)),
        "shadow_price": one.shadow_price,
    }


def _share(share: Proportion) -> dict[str, float]:
    return {
        "estimate": share.estimate,
        "lower": share.lower,
        "upper": share.upper,
        "confidence": share.confidence,
        "count": share.count,
    }
