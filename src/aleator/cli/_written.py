"""Designs as a run has written them for people and programs, in `designs.json`: known without the model's code."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aleator._core.errors import ProblemError
from aleator.reporting import Code, Section, Table, percent, values_text

_DESIGNS = "designs.json"


def written_designs(folder: Path) -> Mapping[str, Any]:
    """The designs of a run as documents, by name; none if there is no file. Raises `ProblemError` for nonsense."""
    path = folder / _DESIGNS
    if not path.is_file():
        return {}
    try:
        found = json.loads(path.read_bytes())
        return {name: found[name] for name in found if isinstance(found[name]["decisions"], dict)}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ProblemError(
            f"'{path}' cannot be read as the designs of a run ({type(error).__name__}: {error})."
        ) from error


def value_text(told: Mapping[str, Any] | None) -> str:
    """A decision or an objective with its unit."""
    if told is None or told["value"] is None:
        return "–"
    return values_text(told["value"], 6, told["unit"])


def interval_text(told: Mapping[str, Any] | None) -> str:
    """The share of systems that break a limit, with its interval."""
    if told is None:
        return "–"
    return f"{percent(told['estimate'])} [{percent(told['lower'])} to {percent(told['upper'])}]"


def written_section(name: str, design: Mapping[str, Any]) -> Section:
    """A design on a page: decisions, objective, how often limits are broken, and the problem as mathematics."""
    rows = [["Status", design["status"]], ["Objective", value_text(design["objective"])]]
    rows += [[decision, value_text(one)] for decision, one in design["decisions"].items()]
    shares = design.get("evidence", {}).get("violations", {})
    rows += [[f"Systems that violate {violated(limit)}", interval_text(one)] for limit, one in shares.items()]
    return Section(name, [Table(name, ["", "Value"], rows), Code("The problem", "\n".join(design["problem"]))])


def violated(limit: str) -> str:
    """A limit of evidence in a sentence."""
    return "any limit" if limit == "any" else limit
