"""The designs of a run: objects of its journal, with the evidence on each, and documents of its `designs.json`.

Documents are known without the model's code; they are shown in tables.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from aleator._core.border import content_of, json_of
from aleator._core.errors import ProblemError
from aleator.reporting import NOTHING, Table, percent, side_by_side, values_text
from aleator.solution import Solution
from aleator.validation import Evidence

_DESIGNS = "designs.json"


def designs_and_evidence(results: Mapping[str, Any]) -> tuple[dict[str, Solution], dict[str, Evidence]]:
    """The designs among results, and the last evidence on each of them, by the names of the designs.

    Where a study names its designs (`designs/robust`), only these count, by the last part of their names.
    """
    solutions = {name: result for name, result in results.items() if isinstance(result, Solution)}
    named = {name.rpartition("/")[2]: solution for name, solution in solutions.items() if "/" in name}
    designs = named or solutions
    evidence = [result for result in results.values() if isinstance(result, Evidence)]
    return designs, {name: last for name, design in designs.items() for last in evidence if _is_on(last, design)}


def _is_on(evidence: Evidence, design: Solution) -> bool:
    sampled = evidence.solution
    return (
        type(sampled.problem.system) is type(design.problem.system)
        and np.array_equal(sampled.vector, design.vector)
        and sampled.problem_text == design.problem_text
    )


def written_designs(folder: Path) -> Mapping[str, Any]:
    """The designs of a run as documents, by name; none if there is no file. Raises `ProblemError` for nonsense."""
    path = folder / _DESIGNS
    if not path.is_file():
        return {}
    try:
        designs = json_of(content_of(path))
        return {name: design for name, design in designs.items() if isinstance(design["decisions"], dict)}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise ProblemError(
            f"'{path}' cannot be read as the designs of a run ({type(error).__name__}: {error})."
        ) from error


def documents_table(caption: str, designs: Mapping[str, Mapping[str, Any] | None]) -> Table:
    """Documents of designs side by side; None where there is no design."""
    columns = {name: {label: text for label, text, _ in rows_of(one)} if one else {} for name, one in designs.items()}
    return side_by_side(caption, columns)


def rows_of(design: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Status, decisions, objective, and how often limits break: the label of each, as text and exactly."""
    yield "Status", design["status"].partition(":")[0], design["status"]
    for name, number in [*design["decisions"].items(), ("Objective", design["objective"])]:
        value, unit = number["value"], number["unit"]
        yield name, NOTHING if value is None else values_text(value, 6, unit), (value, unit)
    for limit, share in design.get("evidence", {}).get("violations", {}).items():
        text = f"{percent(share['estimate'])} [{percent(share['lower'])} to {percent(share['upper'])}]"
        yield f"Systems that violate {'any limit' if limit == 'any' else limit}", text, share
