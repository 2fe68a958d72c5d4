"""The rounds of a solution, in which every call of a solver is made.

The mesh is refined until it is fine enough; an answer is left for a better one nearby; bounds are tightened where
limits break between the instants; realisations that break a limit on the worst case are imposed. Each round starts from
the last one.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aleator.certification import (
    Check,
    Oracle,
    begin_check,
    broken_at,
    check_factor,
    excess_between,
    follows_trajectories,
    idle_scenarios,
    is_checked,
    magnitudes_at,
    margins_for,
    no_margins,
    scenarios_at_start,
    tightened,
    worst_case_limits,
    worst_case_of,
)
from aleator.design import is_over_time
from aleator.nlp import HELD, AbstractSearch, AbstractSolver, NonlinearProgram, Outcome, Status, restart_of
from aleator.solution import TOLERATED, Between, WorstCase
from aleator.transcription import AbstractTranscribed, blind_decisions, refuse_blind, valued_by

# How often at most: an answer is left for a better one, bounds are tightened, and scenarios are added.
_MOST_RESTARTS, _MOST_TIGHTENINGS, _MOST_SCENARIOS = 8, 12, 20


class Held(NamedTuple):
    """The last program of a solution and its outcome, with what was found on the way.

    - `first`: where the search began; `begun`: the magnitudes of functionals there;
    - `between`: how far limits break between the instants, `check`: the check at the answer, `worst_case`: the worst
      realisations; None where these do not apply.
    """

    transcribed: AbstractTranscribed
    first: np.ndarray
    begun: list[float]
    outcome: Outcome
    between: Between | None = None
    check: Check | None = None
    worst_case: WorstCase | None = None


class Rounds(NamedTuple):
    """How programs are solved: `between` as in `solve`; `heed` raises if the user interrupts."""

    solver: AbstractSolver
    between: int | None
    heed: Callable[[], None]
    executor: Executor | None

    def held(
        self,
        transcribed: AbstractTranscribed,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
        known: WorstCase | None,
        *,
        refines: bool,
    ) -> Held:
        """The answer to a problem.

        - `start`, `multipliers`: None where nothing is known; `known`: the worst case of an earlier solution;
        - `refines`: whether meshes are.
        """
        solved = None
        while refines:
            solved = self._solved(transcribed, start, None)
            if solved.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if solved.status is not Status.SOLVED:
                break
            start = solved.point
            finer = transcribed.refined(start)
            if finer is None:
                break
            transcribed, start = finer
        problem, oracle = transcribed.problem, None
        if worst_case_limits(problem) and problem.placements.germs:
            factor = check_factor(problem, self.between) if self._judges_between(transcribed) else 1
            oracle, solved = Oracle(problem, factor), None
            transcribed = transcribed.at_scenarios(scenarios_at_start(transcribed, oracle, start, known))
        first = transcribed.program.start if start is None else start
        begun = magnitudes_at(transcribed, first)
        solved = self._solved(transcribed, start, multipliers) if solved is None else solved
        if multipliers is None and solved.status is not Status.INTERRUPTED:
            solved = _looked_around(transcribed, self.solver.local, solved, start)
        held = self._held_between(Held(transcribed, first, begun, solved))
        return held if oracle is None else self._held_at_worst(held, oracle)

    def _solved(
        self,
        transcribed: AbstractTranscribed,
        start: np.ndarray | None,
        multipliers: np.ndarray | None,
        solver: AbstractSolver | None = None,
        program: NonlinearProgram | None = None,
    ) -> Outcome:
        self.heed()
        solver, program = solver or self.solver, program or transcribed.program
        # Multipliers at the instants of another grid say nothing here.
        fits = multipliers is not None and multipliers.shape == program.constraint_lower.shape
        executor = self.executor if isinstance(solver, AbstractSearch) else None
        program = valued_by(executor, program, "solve")
        return solver.solve(program, start=start, multipliers=multipliers if fits else None)

    def _judges_between(self, transcribed: AbstractTranscribed) -> bool:
        return self.between != 1 and any(map(is_over_time, transcribed.problem.constraints))

    def _held_between(self, held: Held) -> Held:
        """Tighten bounds at instants between which limits break, and solve again, until they hold.

        An outcome that is not solved is returned unchanged.
        """
        self.heed()
        transcribed, outcome = held.transcribed, held.outcome
        factor = check_factor(transcribed.problem, self.between)
        if outcome.status is not Status.SOLVED or not is_checked(transcribed.problem):
            return held
        check = begin_check(transcribed, outcome.point, factor)()
        if factor == 1 or not self._judges_between(transcribed):
            return held._replace(check=check)
        excess = excess_between(transcribed, outcome.point, check)
        margins, rounds = no_margins(excess), [(outcome, check, excess)]
        best = rounds[0]
        while HELD < excess.worst < np.inf and len(rounds) <= _MOST_TIGHTENINGS:
            # Margins may shrink in the first rounds; later they only grow, so that the iteration ends.
            margins = margins_for(margins, excess, relax=len(rounds) <= _MOST_TIGHTENINGS // 2)
            program, last = tightened(transcribed, margins), rounds[-1][0]
            again = self._solved(transcribed, last.point, last.multipliers, self.solver.local, program)
            if again.status is Status.INTERRUPTED:
                return held._replace(outcome=again)
            if again.status is not Status.SOLVED:
                break
            check = begin_check(transcribed, again.point, factor)()
            excess = excess_between(transcribed, again.point, check)
            rounds.append((again, check, excess))
            if excess.worst <= best[2].worst:
                best = rounds[-1]
            elif best[2].worst <= TOLERATED:
                break  # Tighter bounds may make the plan bulge more between them.
        answer, check, excess = best
        is_strict = self.between is not None or len(rounds) > 1 or follows_trajectories(transcribed.problem)
        loosest = outcome.evaluation.objective
        rise = answer.evaluation.objective - loosest
        cost = rise / max(abs(loosest), abs(answer.evaluation.objective)) if rise > 0 else 0.0
        between = Between(factor, excess.worst, excess.where, excess.when, is_strict, cost)
        others = [one[0] for one in rounds if one is not best]
        return held._replace(outcome=answer.with_effort_of(*others), between=between, check=check)

    def _held_at_worst(self, held: Held, oracle: Oracle) -> Held:
        """Impose limits at realisations that break them, and solve again, until none is found."""
        rounds, worst, is_found = 1, np.zeros((0, len(oracle.low))), True
        while held.outcome.status is Status.SOLVED:
            transcribed, before = held.transcribed, held.outcome
            new, worst = broken_at(transcribed, oracle, before, rounds)
            if not len(new):
                break
            if rounds == _MOST_SCENARIOS:
                is_found = False
                break
            assert transcribed.scenarios is not None
            idle = idle_scenarios(transcribed, before.point)
            transcribed = transcribed.at_scenarios(transcribed.scenarios.joined(new, idle))
            begun = transcribed.point(transcribed.decisions(before.point))
            again = self._solved(transcribed, begun, before.multipliers, self.solver.local)
            held = self._held_between(Held(transcribed, held.first, held.begun, again))
            held = held._replace(outcome=held.outcome.with_effort_of(before))
            rounds += 1
        return held._replace(
            worst_case=worst_case_of(held.transcribed, held.outcome, oracle, worst, rounds, is_found=is_found)
        )


def _looked_around(
    transcribed: AbstractTranscribed, solver: AbstractSolver, outcome: Outcome, start: np.ndarray | None
) -> Outcome:
    """The outcome of a start of which nothing is known, or a better one found by points elsewhere."""
    program, found = transcribed.program, outcome
    begun = program.start if start is None else start
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
