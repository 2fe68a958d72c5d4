"""One search for the answer of a program, and other ways to one where it ends without."""

import functools
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from aleator._core.errors import ProblemError
from aleator.design import Problem, widened
from aleator.nlp import (
    HELD,
    AbstractSearch,
    AbstractSolver,
    Ipopt,
    NonlinearProgram,
    Outcome,
    Status,
    default_solver,
    least_excess,
    restart_of,
)
from aleator.transcription import (
    AbstractTranscribed,
    blind_decisions,
    refuse_blind,
    rows_by_name,
    transcribe,
    valued_by,
)

UNSOLVED = (Status.INFEASIBLE, Status.FAILED, Status.ITERATION_LIMIT)
"""Ends of a search that a grid which is far off may have led astray."""

# How often at most an answer is left for a better one, and within how many boxes a search goes on that strayed.
_MOST_RESTARTS, _MOST_BOXES = 8, 16
# Iterations to a design that meets the limits, or to the least excess, however few the search itself was allowed.
_MOST_TO_LIMITS = 200
# As many decisions or more are searched by interior points where active sets change too slowly.
_MANY = 30
# Factors of spreads by which a search among probabilities finds its way.
_WIDER = tuple(2.0**i for i in range(10, 0, -1))


class Search(NamedTuple):
    """How programs are searched.

    - `executor`: simulates the generations of searches by values; `heed`: raises if the user interrupts.
    """

    solver: AbstractSolver
    executor: Executor | None
    heed: Callable[[], None]

    def run(
        self,
        transcribed: AbstractTranscribed,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
        program: NonlinearProgram | None = None,
        *,
        goes_on: bool = False,
    ) -> Outcome:
        """One search: of a transcribed program, or of another in its place. One that goes on stays near its start."""
        self.heed()
        solver, program = self.solver.local if goes_on else self.solver, program or transcribed.program
        # Multipliers at the instants of another grid say nothing here.
        fits = multipliers is not None and multipliers.shape == program.constraint_lower.shape
        executor = self.executor if isinstance(solver, AbstractSearch) else None
        program = valued_by(executor, program, "solve")
        return solver.solve(program, start=start, multipliers=multipliers if fits else None)

    def led_on(self, transcribed: AbstractTranscribed, start: np.ndarray, outcome: Outcome) -> Outcome:
        """The outcome of a search from a start, or of one by another way where it ended without an answer."""
        by_wide_spreads, shortly = functools.partial(self._by_wide_spreads, start), self._by_short_steps
        for way in (self._from_inside, shortly, by_wide_spreads, shortly, self._with_limits_met):
            outcome = way(transcribed, outcome) if outcome.status in UNSOLVED else outcome
        return outcome

    def _by_wide_spreads(self, start: np.ndarray, transcribed: AbstractTranscribed, outcome: Outcome) -> Outcome:
        """An outcome of a search among probabilities, which are 0 or 1 far from their bounds: goes on from where the
        same search leads with spreads that are first very large, and are halved from answer to answer.
        """
        decisions = transcribed.decisions(start)
        for factor in _WIDER:
            problem = widened(transcribed.problem, factor)
            wide = None if problem is None else _simulated(transcribed, problem)
            if wide is None:
                return outcome
            within = self.run(wide, decisions, None, goes_on=True)
            outcome, decisions = outcome.with_effort_of(within), wide.decisions(within.point)
            if within.status is Status.INTERRUPTED:
                return replace(outcome, status=Status.INTERRUPTED)
        further = self.run(transcribed, transcribed.point(decisions), None, goes_on=True)
        is_worse = further.status in UNSOLVED and further.violation > max(outcome.violation, HELD)
        return outcome.with_effort_of(further) if is_worse else further.with_effort_of(outcome)

    def _by_short_steps(self, transcribed: AbstractTranscribed, outcome: Outcome) -> Outcome:
        """An outcome that strayed from designs that meet the limits, as to where a probability is flat: goes on from
        the best of these within boxes around it, which shrink where a search fails and grow where it ends at a wall.
        """
        if not outcome.strayed:
            return outcome
        program, solver = transcribed.program, replace(self.solver.local, max_iterations=_MOST_TO_LIMITS)
        search, point, radius = self._replace(solver=solver), outcome.point, program.variable_scale
        for _ in range(_MOST_BOXES):
            lower, upper = np.maximum(program.lower, point - radius), np.minimum(program.upper, point + radius)
            box = replace(program, lower=lower, upper=upper)
            within = search.run(transcribed, point, None, box)
            outcome = outcome.with_effort_of(within)
            if within.status is Status.INTERRUPTED:
                return replace(outcome, status=Status.INTERRUPTED)
            is_solved, end = within.status is Status.SOLVED, within.point
            walls = ((end <= lower) & (lower > program.lower)) | ((end >= upper) & (upper < program.upper))
            if is_solved and not walls.any():
                return self.run(transcribed, end, within.multipliers, goes_on=True).with_effort_of(outcome)
            point, radius = (end, 2 * radius) if is_solved else (point, radius / 4)
        return outcome

    def _from_inside(self, transcribed: AbstractTranscribed, outcome: Outcome) -> Outcome:
        """An outcome that meets all limits, but is no optimum: active sets of many decisions, such as controls that
        jump between their bounds, may change so slowly that the solver nobody chose goes on by interior points.
        """
        is_inside = outcome.violation <= HELD and not outcome.strayed
        if not is_inside or outcome.point.size < _MANY or self.solver != default_solver():
            return outcome
        further = self._replace(solver=Ipopt(self.solver.tolerance)).run(transcribed, outcome.point, None)
        ends = further.status in (Status.SOLVED, Status.INTERRUPTED)
        return further.with_effort_of(outcome) if ends else outcome.with_effort_of(further)

    def _with_limits_met(self, transcribed: AbstractTranscribed, outcome: Outcome) -> Outcome:
        """An outcome whose search ended where limits do not hold: goes on from a design at which they do.

        That is one of least excess whatever the objective, states being simulated. If no step lowers the excess there,
        limits contradict one another, which no further iteration would mend. Where a program with states as variables
        has shown that already, nothing is compiled to ask again.
        """
        is_shown = outcome.status is Status.INFEASIBLE and transcribed.states_at(outcome.point) is not None
        if outcome.violation <= HELD or outcome.strayed or is_shown:
            return outcome
        simulated = _simulated(transcribed, transcribed.problem)
        return outcome if simulated is None else self.by_least_excess(transcribed, outcome, simulated)

    def by_least_excess(
        self,
        transcribed: AbstractTranscribed,
        outcome: Outcome,
        simulated: AbstractTranscribed,
        groups: list[tuple[Int[np.ndarray, " rows"], float]] | None = None,
    ) -> Outcome:
        """The same by a program whose states are simulated.

        - `groups`: the rows of each name of limits in it, with their size; those of its problem by default.
        """
        solver, groups = replace(self.solver.local, max_iterations=_MOST_TO_LIMITS), groups or rows_by_name(simulated)
        start = [simulated.program.start]
        least = least_excess(solver, simulated.program, groups, (), range(len(groups)), start)
        if least.total <= HELD:
            start = transcribed.point(simulated.decisions(least.point))
            further = self.run(transcribed, start, None, goes_on=True)
            if further.violation <= HELD:
                return further.with_effort_of(outcome)
            missed = "A design meets all limits, but the search leaves it: give start=al.conflict(problem).nearest"
            return replace(outcome, status=Status.FAILED, message=missed).with_effort_of(further)
        if not least.is_shown:
            return outcome
        problem = simulated.problem
        limits = (problem.named(name) for name, rows in zip(problem.names, least.pushing, strict=True) if len(rows))
        pushing = (own[0].name + (f" ({'; '.join(map(str, own))})" if len(own) > 1 else "") for own in limits)
        said = f" (the solver said: {outcome.visited.end})" if outcome.visited else ""
        message = (
            f"Relax a limit: no design was found that meets all of these, whatever it costs: {', '.join(pushing)}; "
            "al.conflict names the fewest, and by how much each would have to be relaxed"
        )
        return replace(outcome, status=Status.INFEASIBLE, message=message + said)


def _simulated(transcribed: AbstractTranscribed, problem: Problem) -> AbstractTranscribed | None:
    """A problem with its states simulated, and another transcription's scenarios and bounds of decisions; None where
    that is refused: histories on a fine mesh may not fit into memory.
    """
    try:
        simulated = transcribe(problem)
    except ProblemError:
        return None
    if transcribed.scenarios is not None:
        simulated = simulated.at_scenarios(transcribed.scenarios)
    lower, upper = map(transcribed.decisions, (transcribed.program.lower, transcribed.program.upper))
    return replace(simulated, program=replace(simulated.program, lower=lower, upper=upper))


def looked_around(
    transcribed: AbstractTranscribed, solver: AbstractSolver, outcome: Outcome, begun: np.ndarray
) -> Outcome:
    """The outcome of a start of which nothing is known, or a better one found by points elsewhere."""
    program, found = transcribed.program, outcome
    for _ in range(_MOST_RESTARTS):
        restart = restart_of(program, outcome, begun)
        outcome = replace(outcome, idle=restart.idle, blind=restart.blind)
        if restart.start is None:
            break
        further = solver.solve(restart.program, start=restart.start)
        if not restart.is_better(outcome, further):
            outcome = outcome.with_effort_of(further)
            break
        # Led away from a saddle, all of its variables may have ended on another one.
        outcome, begun = further.with_effort_of(outcome), further.point
    if outcome.searched is None:
        refuse_blind(outcome, transcribed)
        return outcome
    if outcome.status is Status.INTERRUPTED:
        return replace(found, status=Status.INTERRUPTED)
    # A search has compared values, so that it has chosen, though derivatives cannot confirm it.
    names = blind_decisions(outcome, transcribed)
    end = f"{outcome.searched.end}; its values alone chose {names}, by which its derivatives are zero"
    return replace(outcome, searched=replace(outcome.searched, end=end)) if names else outcome
