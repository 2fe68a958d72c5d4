"""Variables that an answer left at their start, where a maximum, a saddle or a flat model satisfies the conditions.

First-order conditions hold at maxima, at saddles (a start on a line of symmetry never leaves it), and wherever a model
is flat. Solvers descend, so that they end there only if they began there: a few points nearby are checked.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aleator.nlp._matrices import column_is_zero
from aleator.nlp._outcome import Outcome, Status
from aleator.nlp._program import Evaluation, NonlinearProgram

# A variable has moved if it differs by more than this part of its typical magnitude.
_STILL = 1e-9
# Distances of the points checked near the answer, in typical magnitudes, and further ones if nothing changes there.
_BESIDE, _BEYOND = (-0.05, 0.05), (-3.0, -1.0, 1.0, 3.0)
# At most this many variables are checked: the first ones.
_MOST = 12
# A decrease by less than this part of the terms is rounding, or negligible curvature.
_LOWER = 1e-7
# Values that differ by less than this part count as equal.
_SAME = 1e-12


class _Probe(NamedTuple):
    """A point near the answer, with one variable moved, and its evaluation."""

    point: np.ndarray
    found: Evaluation


def moved_on(
    program: NonlinearProgram, outcome: Outcome, start: np.ndarray, again: Callable[[np.ndarray], Outcome]
) -> Outcome:
    """The outcome, or a better one if it is no minimum with respect to variables that never moved.

    - `start`: the start of the outcome, shape (n,); `again`: solves from another start.

    The result's `idle` lists variables that change nothing, `blind` those that do although their derivatives are zero.
    """
    if outcome.status is not Status.SOLVED:
        return outcome
    still = _still(program, outcome, start)[:_MOST]
    if not len(still):
        return outcome
    probes = {int(one): _probes(program, outcome, int(one)) for one in still}
    flat = [one for one in probes if _is_flat(outcome.evaluation, one)]
    changing = [one for one in flat if any(_differs(outcome.evaluation, each.found) for each in probes[one])]
    blind = tuple(one for one in changing if all(_is_flat(each.found, one) for each in probes[one]))
    idle = tuple(one for one in flat if one not in changing)
    outcome = replace(outcome, blind=blind, idle=idle)
    every = [one for several in probes.values() for one in several]
    value, terms = _lagrangian(outcome, outcome.evaluation)
    lower = [one for one in every if _lagrangian(outcome, one.found)[0] < value - _LOWER * terms]
    if blind or not lower:
        return outcome
    return _better(outcome, again(min(lower, key=lambda one: _lagrangian(outcome, one.found)[0]).point))


def _still(program: NonlinearProgram, outcome: Outcome, start: np.ndarray) -> np.ndarray:
    """The free variables that have not moved and are not held by an active bound."""
    scale, evaluation = program.variable_scale, outcome.evaluation
    still = (np.abs(outcome.point - start) <= _STILL * scale) & (program.lower < program.upper)
    pulls = np.abs(outcome.bound_multipliers) * scale
    largest = max(abs(evaluation.objective), float(np.max(np.abs(evaluation.gradient) * scale, initial=0.0)))
    return np.flatnonzero(still & (pulls <= _LOWER * largest))


def _probes(program: NonlinearProgram, outcome: Outcome, which: int) -> list[_Probe]:
    """Points near the answer and, if all derivatives by the variable are zero, in its whole range."""
    steps = _BESIDE + (_BEYOND if _is_flat(outcome.evaluation, which) else ())
    lower, upper, here = program.lower[which], program.upper[which], outcome.point[which]
    places = {float(np.clip(here + step * program.variable_scale[which], lower, upper)) for step in steps}
    if len(steps) > len(_BESIDE) and np.isfinite(lower) and np.isfinite(upper):
        places |= set(np.linspace(lower, upper, 5).tolist())
    found = []
    for place in sorted(places - {float(here)}):
        point = outcome.point.copy()
        point[which] = place
        evaluation = program.evaluate(point)
        if np.isfinite(evaluation.objective) and np.isfinite(evaluation.constraints).all():
            found.append(_Probe(point, evaluation))
    return found


def _is_flat(evaluation: Evaluation, which: int) -> bool:
    return evaluation.gradient[which] == 0 and column_is_zero(evaluation.jacobian, which)


def _differs(one: Evaluation, other: Evaluation) -> bool:
    first, second = (np.append(each.constraints, each.objective) for each in (one, other))
    return bool(np.any(np.abs(first - second) > _SAME * np.maximum(np.abs(first), np.abs(second))))


def _lagrangian(outcome: Outcome, evaluation: Evaluation) -> tuple[float, float]:
    """The Lagrangian at a point, with the multipliers of the answer, and the size of the terms that it consists of."""
    terms = outcome.multipliers * (evaluation.constraints - outcome.evaluation.constraints)
    return evaluation.objective + float(terms.sum()), abs(evaluation.objective) + float(np.abs(terms).sum())


def _better(before: Outcome, after: Outcome) -> Outcome:
    """The later outcome if it is solved and lower, with the effort of both."""
    gain = before.evaluation.objective - after.evaluation.objective
    lower = after.status is Status.SOLVED and gain > _LOWER * abs(before.evaluation.objective)
    interrupted = after.status is Status.INTERRUPTED
    return after.with_effort_of(before) if lower or interrupted else before.with_effort_of(after)
