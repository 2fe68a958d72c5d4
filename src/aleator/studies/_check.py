"""What a study will do, before anything is spent: sizes, quality of the points, derivatives, time."""

import time
from collections.abc import Mapping
from typing import Any, final

import jax
import numpy as np

from aleator._core.arrays import NUMBER
from aleator._core.errors import SimulationError
from aleator._core.leaves import AbstractLeaf
from aleator.design import Problem, problem_text
from aleator.dynamics import Grid
from aleator.examining import examine
from aleator.reporting import Code, Table, side_by_side
from aleator.studies._own import Study, problems_of
from aleator.studies._study import AbstractStudy
from aleator.transcription import DEFAULT, transcribe
from aleator.uncertainty import fields_of

# Evaluations of a typical solve by derivatives, for predictions.
_EVALUATIONS = 30


@final
class Check:
    """The problems of a study: what each is, how well it is posed, and what it will take.

    - `facts`: what is known of each before it is solved, by the names of designs; `instants` and `samples` are None
      where there are none, times are of this machine at the start, and `bytes_of_derivatives` those of all rows;
    - `troubles`: what may stop a solver, a sentence each.

    Raises `ProblemError` if the study declares no problems.
    """

    def __init__(self, study: AbstractStudy):
        self._problems, self.troubles = problems_of(study), list[str]()
        self._solves, samples = (study.solves, study.samples) if isinstance(study, Study) else (0, None)
        self.facts = {name: _facts(one, samples) for name, one in self._problems.items()}
        for name, problem in self._problems.items():
            try:
                found = examine(problem)
                troubles = [*found.kinks, *found.jumps, *found.wrong, *found.endless, *found.unfit]
                self.facts[name]["derivatives_agree"] = found.ok
            except SimulationError as error:
                troubles = [str(error)]
            self.troubles += [f"{name}: {trouble}" for trouble in troubles]

    def mathematics(self) -> list[Code]:
        """Each problem as mathematics."""
        return [Code(name, problem_text(one, ""), True) for name, one in self._problems.items()]

    def numbers(self) -> Table | None:
        """The numbers of each model in the units that it declares, as a file may have changed them."""
        columns = {
            name: {key: _text(one) for key, one in _numbers(problem).items()}
            for name, problem in self._problems.items()
        }
        return side_by_side("Numbers of the model", columns) if any(columns.values()) else None

    def table(self) -> Table:
        """A column for each problem."""
        solves = f", and {self._solves} {'solve' if self._solves == 1 else 'solves'} in all" if self._solves else ""
        note = f"Times on this machine, at the start: {_EVALUATIONS} evaluations for a solve{solves}."
        return side_by_side("What will be done", {name: _column(one) for name, one in self.facts.items()}, note)

    def document(self) -> Mapping[str, Any]:
        """The same for programs."""
        return {name: {**facts, "numbers": _numbers(self._problems[name])} for name, facts in self.facts.items()}


def _numbers(problem: Problem) -> dict[str, dict[str, Any]]:
    """The numbers of a model by name: each its value, or the distribution or decision in its place, and its unit."""
    numbers = {}
    for name, field, value in fields_of(problem.system):
        is_number = isinstance(value, int | float | np.generic | np.ndarray | jax.Array) and not isinstance(value, bool)
        unit = field.metadata.get("unit", "")
        if isinstance(value, AbstractLeaf):
            numbers[name] = {"value": str(value), "unit": unit}
        elif is_number and not field.metadata.get("static", False) and np.ndim(value) == 0:
            numbers[name] = {"value": float(value), "unit": unit}
    return numbers


def _text(number: Mapping[str, Any]) -> str:
    value = number["value"]
    return f"{value if isinstance(value, str) else f'{value:.7g}'} {number['unit']}".removesuffix(" -").rstrip()


def _facts(problem: Problem, samples: int | None) -> dict[str, Any]:
    """What is known of a problem."""
    began = time.perf_counter()
    transcribed = transcribe(problem, DEFAULT)
    compiled = time.perf_counter()
    program, basis, collocation = transcribed.program, transcribed.basis, transcribed.collocation
    # Derivatives as well, at a point that is not remembered.
    program.evaluate(np.clip(program.start + 1e-6 * program.variable_scale, program.lower, program.upper))
    evaluated = time.perf_counter()
    rows, decisions = len(program.constraint_lower), problem.placements.size
    return {
        "decisions": decisions,
        "uncertain": basis.variables,
        "instants": problem.grid.steps + 1 if isinstance(problem.grid, Grid) else None,
        "order": basis.order,
        "terms": basis.terms,
        "points": len(collocation.points),
        "condition_number": float(collocation.condition_number),
        "rows": rows,
        "derivatives_agree": False,
        "seconds_to_compile": compiled - began,
        "seconds_of_evaluation": evaluated - compiled,
        "samples": samples,
        # Of a solve, and of its evidence.
        "simulations": _EVALUATIONS * len(collocation.points) + (samples or 0 if basis.variables else 1),
        "bytes_of_derivatives": NUMBER * rows * (1 + decisions),
    }


def _column(facts: Mapping[str, Any]) -> dict[str, str]:
    """What is printed of these facts."""
    return {
        "decisions": f"{facts['decisions']}",
        "uncertain numbers": f"{facts['uncertain']}",
        "instants": f"{facts['instants'] or 'no time'}",
        "expansion": f"order {facts['order']}, {facts['terms']} terms",
        "collocation points": f"{facts['points']}",
        "condition number": f"{facts['condition_number']:.3g}",
        "rows of limits": f"{facts['rows']}",
        "derivatives": "agree with differences" if facts["derivatives_agree"] else "see below",
        "compilation": f"{facts['seconds_to_compile']:.2g} s",
        "one solve": f"about {_EVALUATIONS * facts['seconds_of_evaluation']:.2g} s",
    }
