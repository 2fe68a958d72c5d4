"""From the end of a nonlinear program back to the `Solution` of a problem."""

from typing import Any

import numpy as np

from aleator import _core
from aleator.certification._quality import quality_of
from aleator.design import expanded_functionals
from aleator.nlp import Outcome, Status
from aleator.solution import (
    Between,
    Certificate,
    ConstraintResult,
    Effort,
    GridError,
    Moments,
    Solution,
    Times,
    WorstCase,
)
from aleator.transcription import AbstractTranscribed, Meaning, as_read

_UNFINISHED = (Status.INFEASIBLE, Status.ITERATION_LIMIT, Status.EVALUATION_FAILED, Status.FAILED)


def solution_of(
    transcribed: AbstractTranscribed,
    outcome: Outcome,
    between: Between | None,
    error: GridError | None,
    worst_case: WorstCase | None,
    misled: str,
    compiled: float,
) -> Solution:
    """The solution of a problem for an outcome of its program.

    `between`, `error`, `worst_case`, `misled`: parts of its `Certificate`; `compiled`: time of its compilations, s.
    """
    problem, places = transcribed.problem, transcribed.places
    meaning, resolved = transcribed.at(outcome.point), transcribed.resolve(outcome.point)
    names, decided = places.entry_names(), transcribed.decided
    entries = dict(zip(decided.tolist(), names, strict=True))
    # Multipliers of a search that was not finished say nothing of what a push would change.
    is_unfinished = outcome.status in _UNFINISHED
    told = (None, None) if is_unfinished else transcribed.costates_at(outcome.point, outcome.multipliers)
    costates, switching = told
    # Limits on the worst case use the model itself.
    asked = {one.text() for one in expanded_functionals(problem.expressions)}
    expanded = {text: one for text, one in resolved.items() if text in asked}
    return Solution(
        problem=problem,
        status=outcome.status,
        message=outcome.message,
        decisions=_plain(places.named(meaning.decisions)),
        vector=meaning.decisions,
        objective=meaning.objective,
        constraints=_constraint_results(transcribed, outcome, meaning),
        moments={text: Moments(np.asarray(one.mean), np.asarray(one.std)) for text, one in resolved.items()},
        statistics=transcribed.statistics(outcome.point),
        at_bounds=tuple(np.array(names)[outcome.active_bounds[decided]].tolist()),
        idle=tuple(entries[i] for i in outcome.idle if i in entries),
        multipliers=outcome.multipliers,
        bound_multipliers=_plain(places.named(outcome.bound_multipliers[decided])),
        certificate=Certificate(
            violation=outcome.violation,
            stationarity=outcome.stationarity,
            complementarity=outcome.complementarity,
            expansion=quality_of(transcribed, expanded, outcome.point),
            between=between,
            grid_error=error,
            worst_case=worst_case,
            misled=misled,
        ),
        effort=Effort(
            solver=outcome.solver,
            iterations=outcome.iterations,
            evaluations=outcome.evaluations,
            times=Times(_core.import_seconds, compiled, outcome.seconds),
            searched=outcome.searched,
            visited=outcome.visited,
        ),
        meshes=transcribed.meshes_at(outcome.point),
        states=transcribed.states_at(outcome.point),
        costates=costates,
        switching=switching,
    )


def _plain(named: dict[str, Any]) -> dict[str, Any]:
    return {name: float(value) if np.ndim(value) == 0 else value for name, value in named.items()}


def _constraint_results(
    transcribed: AbstractTranscribed, outcome: Outcome, meaning: Meaning
) -> tuple[ConstraintResult, ...]:
    results = []
    each = transcribed.texts.constraints, transcribed.rows, meaning.constraints
    for constraint, text, rows, own in zip(transcribed.problem.constraints, *each, strict=True):
        instants = meaning.times if constraint.is_path else None
        parts = own, outcome.multipliers[rows], outcome.active[rows]
        values, multipliers, active = (
            _shaped(part, instants) for part in as_read(constraint, transcribed.scenarios, *parts)
        )
        results.append(
            ConstraintResult(
                name=constraint.name,
                text=text,
                lower=float(constraint.lower),
                upper=float(constraint.upper),
                values=values,
                times=instants,
                multipliers=multipliers,
                active=active,
                scale=float(outcome.sizes[rows].max()),
            )
        )
    return tuple(results)


def _shaped(rows: np.ndarray, times: np.ndarray | None) -> np.ndarray:
    """A constraint's rows by instant, if it has several at each."""
    return rows if times is None or len(rows) == len(times) else rows.reshape(len(times), -1)
