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
    every = [one for one in finished.values() if isinstance(one, Evidence)]
    found = {name: [one for one in every if _is_on(one, design)] for name, design in designs.items()}
    return designs, {name: on[-1] for name, on in found.items() if on}


def _is_on(evidence: Evidence, design: Solution) -> bool:
    on = evidence.solution
    return (
        type(on.problem.system) is type(design.problem.system)
        and np.array_equal(on.vector, design.vector)
        and on.problem_text == design.problem_text
    )
