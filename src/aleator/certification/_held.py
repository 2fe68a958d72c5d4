"""A solution whose limits over time hold between the instants too."""

from typing import NamedTuple

import numpy as np

from aleator.certification._between import excess_between, margins_for, no_margins, tightened
from aleator.certification._reference import Reference, follows_trajectories, reference, reference_factor
from aleator.design import is_over_time
from aleator.nlp import HELD, AbstractSolver, Outcome, Status
from aleator.solution import Between
from aleator.transcription import AbstractTranscribed

# How often limits between instants are tightened at most.
_MOST_TIGHTENINGS = 12


class Held(NamedTuple):
    """An outcome, its excess between instants (None if not checked), and its numbers on the finer grid, if any."""

    outcome: Outcome
    between: Between | None
    finer: Reference | None


def held_between(
    transcribed: AbstractTranscribed, solver: AbstractSolver, outcome: Outcome, between: int | None
) -> Held:
    """Tighten the bounds at instants between which limits are exceeded, and solve again, until they hold.

    `between`: see `solve`. An outcome that is not solved is returned unchanged.
    """
    problem = transcribed.problem
    factor = reference_factor(problem, between)
    if factor == 1 or outcome.status is not Status.SOLVED:
        return Held(outcome, None, None)
    finer = reference(transcribed, outcome.point, factor)
    if between == 1 or not any(map(is_over_time, problem.constraints)):
        return Held(outcome, None, finer)
    excess = excess_between(transcribed, outcome.point, finer)
    margins, done, loosest = no_margins(excess), 0, outcome.evaluation.objective
    while HELD < excess.worst < np.inf and done < _MOST_TIGHTENINGS:
        # Margins may shrink in the first rounds; later they only grow, so that the iteration ends.
        margins = margins_for(margins, excess, relax=done < _MOST_TIGHTENINGS // 2)
        again = solver.solve(tightened(transcribed, margins), start=outcome.point, multipliers=outcome.multipliers)
        if again.status is Status.INTERRUPTED:
            return Held(again, None, None)
        if again.status is not Status.SOLVED:
            break
        done += 1
        outcome = again.with_effort_of(outcome)
        finer = reference(transcribed, outcome.point, factor)
        excess = excess_between(transcribed, outcome.point, finer)
    is_strict = between is not None or done > 0 or follows_trajectories(problem)
    cost = _part(outcome.evaluation.objective - loosest, loosest)
    return Held(outcome, Between(factor, excess.worst, excess.where, excess.when, is_strict, cost), finer)


def _part(rise: float, objective: float) -> float:
    """A rise of the objective as a part of it."""
    return max(rise, 0.0) / abs(objective) if rise > 0 and objective else 0.0
