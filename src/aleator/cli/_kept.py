"""Designs in a run's folder, with the evidence on each."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from aleator.solution import Solution
from aleator.validation import Evidence


def sorted_by_kind(finished: Mapping[str, Any]) -> tuple[dict[str, Solution], dict[str, Evidence]]:
    """The designs among results, and the last evidence on each of them, by the names of the designs.

    Where a study names its designs (`designs/robust`), only these are told, by the last part of their names.
    """
    solutions = {name: one for name, one in finished.items() if isinstance(one, Solution)}
    named = {name.rpartition("/")[2]: one for name, one in solutions.items() if "/" in name}
    designs = named or solutions
    found = {name: evidence_on(design, finished) for name, design in designs.items()}
    return designs, {name: one for name, one in found.items() if one is not None}


def evidence_on(design: Solution, finished: Mapping[str, Any]) -> Evidence | None:
    """The last evidence on a design among results; None if there is none."""
    found = [one for one in finished.values() if isinstance(one, Evidence) and _is_on(one, design)]
    return found[-1] if found else None


def _is_on(evidence: Evidence, design: Solution) -> bool:
    on = evidence.solution
    return (
        type(on.problem.system) is type(design.problem.system)
        and np.array_equal(on.vector, design.vector)
        and on.problem_text == design.problem_text
    )
