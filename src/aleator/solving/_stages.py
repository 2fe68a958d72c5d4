"""The stages of one solution, in which every call of a solver is made: transcribe, search, hold limits, judge, say.

The mesh is refined until it is fine enough; an answer is left for a better one nearby; bounds are tightened where
limits break between the instants; realisations that break a limit on the worst case are imposed. Each search starts
from the last one.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from aleator.certification._between import cost_of_margins, excess_between, limits_beside, margins_for, tightened
from aleator.certification._check import Check, begin_check
from aleator.certification._grids import Start, grid_error, misled_at
from aleator.certification._judgement import Held, diagnose, solution_of
from aleator.certification._systems import check_factor, is_checked, pieces, prepare_check
from aleator.certification._worst_case import Oracle, worst_case_limits
from aleator.design import Problem, destabilised, in_quantiles, is_over_time
from aleator.nlp import HELD, Outcome, Status
from aleator.solution import TOLERATED, Solution, WorstCase
from aleator.solving._search import UNSOLVED, Search, looked_around
from aleator.transcription import AbstractTranscribed, AbstractTranscription, divided, transcribe

# How often at most limits are held between the instants, and scenarios are added.
_MOST_TIGHTENINGS, _MOST_SCENARIOS = 12, 20
# Iterations from an answer to a close one with peaks limited.
_MOST_STEPS = 25
# The tolerance of answers by which meshes are chosen: of less accurate ones the errors are their own, and more meshes
# follow.
_ROUGH = 1e-4


class Stages(NamedTuple):
    """The stages of a solution, the same on each grid: `between` and `accuracy` as in `solve`.

    `keeps_grid`: whether no answer on a finer grid follows.
    """

    transcription: AbstractTranscription
    search: Search
    between: int | None
    accuracy: float
    keeps_grid: bool

    def answer(
        self,
        problem: Problem,
        start: np.ndarray | None,
        multipliers: np.ndarray | None = None,
        known: WorstCase | None = None,
    ) -> tuple[Solution, Held]:
        """The solution of a problem on its grid, and what it was found by.

        - `start`: decisions; `multipliers`: None where nothing is known; `known`: the worst case of an earlier
          solution.
        """
        # Transcribe.
        prepare = functools.partial(prepare_check, check_factor(problem, self.between))
        transcribed = transcribe(in_quantiles(problem), self.transcription, prepare)
        point, outcome = None if start is None else transcribed.point(start), None
        if self.transcription.refines:
            transcribed, point, outcome = self._on_fine_mesh(transcribed, point)
        problem, factor, oracle = transcribed.problem, check_factor(transcribed.problem, self.between), None
        if worst_case_limits(problem) and problem.placements.germs:
            oracle, outcome = Oracle(problem, factor if self.judges_between(problem) else 1), None
            transcribed = oracle.begun(transcribed, transcribed.program.start if point is None else point, known)
        # Search.
        first = transcribed.program.start if point is None else point
        is_unknown = multipliers is None and not self.transcription.is_guessed
        asks_start = is_unknown and factor > 1 and problem.is_integrated
        start_of_search = Start.of(transcribed, first) if asks_start else None
        outcome = searched = self.search.run(transcribed, point, multipliers) if outcome is None else outcome
        if multipliers is None and outcome.status is not Status.INTERRUPTED:
            outcome = looked_around(transcribed, self.search.solver.local, outcome, first)
        outcome = self.search.led_on(transcribed, first, outcome)
        # The mesh is fine enough for what was searched, not for an answer elsewhere.
        is_elsewhere = outcome.status is Status.SOLVED and outcome.point is not searched.point
        if self.transcription.refines and oracle is None and is_elsewhere:
            transcribed, _, outcome = self._on_fine_mesh(transcribed, outcome.point)
            start_of_search = Start.of(transcribed, outcome.point) if asks_start else None
        # Hold limits between the instants, and in the worst case.
        held = self._held_between(Held(transcribed, outcome), factor)
        held = held if oracle is None else self._held_at_worst(held, oracle, factor)
        # Judge.
        if held.outcome.status is Status.INTERRUPTED and held.outcome.searched is None:
            raise KeyboardInterrupt
        held = self._judged(held, start_of_search, factor)
        return solution_of(held), held

    def answer_in_elements(
        self,
        problem: Problem,
        start: np.ndarray | None,
        multipliers: np.ndarray | None = None,
        known: WorstCase | None = None,
    ) -> tuple[Solution, Held]:
        """The same, with elements that suffice at the answer: where they do not, they are divided there, and the search
        goes on. Each division adds elements, whose number the budget of `MultiElement` bounds.
        """
        solution, held = self.answer(problem, start, multipliers, known)
        while solution.status not in (Status.INTERRUPTED, Status.EVALUATION_FAILED):
            finer = divided(held.transcribed.problem, held.transcribed.discretised, solution.vector)
            if finer is None:
                break
            stages = self._replace(transcription=self.transcription.starting_from(solution))
            certificate = solution.certificate
            solution, held = stages.answer(finer, solution.vector, solution.multipliers, certificate.worst_case)
        return solution, held

    def _on_fine_mesh(
        self, transcribed: AbstractTranscribed, start: np.ndarray | None
    ) -> tuple[AbstractTranscribed, np.ndarray | None, Outcome]:
        """The problem on a mesh that is fine enough, where its search began, and the outcome.

        Meshes are chosen by rough answers, since the last digits of one are those of its mesh alone.
        """
        exact, multipliers = self.search, None
        search = exact._replace(solver=replace(exact.solver, tolerance=max(exact.solver.tolerance, _ROUGH)))
        while True:
            outcome, finer = search.run(transcribed, start, multipliers), None
            if outcome.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
            if outcome.status is Status.SOLVED:
                start, multipliers = outcome.point, outcome.multipliers
                finer = transcribed.refined(start)
            if finer is not None:
                (transcribed, start), multipliers = finer, None
            elif search.solver == exact.solver:
                return transcribed, start, outcome
            else:
                search = exact

    def judges_between(self, problem: Problem) -> bool:
        """Whether limits are to hold between the instants too."""
        return self.between != 1 and any(map(is_over_time, problem.constraints))

    def checked(self, held: Held, waiting: Callable[[], Check], cost: float | None = None) -> Held:
        """What was held, with a check of its outcome, and how far limits are exceeded between the instants.

        - `cost`: that of the margins by which it was found, None without any.
        """
        check, problem = waiting(), held.transcribed.problem
        if check.factor == 1 or not self.judges_between(problem):
            return held._replace(check=check)
        is_strict = cost is not None or self.between is not None or pieces(problem) > 0
        between = replace(excess_between(check)[0], is_strict=is_strict, cost=cost or 0.0)
        return held._replace(check=check, between=between)

    def _held_between(self, held: Held, factor: int) -> Held:
        """Limit what breaks between the instants, and solve again until limits hold there: peaks and values beside
        jumps, so that the answer does not depend on where the instants are and its multipliers are slopes of the
        optimum; or, where no answer close by follows from that, by bounds tightened at the instants alone.

        An outcome that is not solved is returned unchanged.
        """
        self.search.heed()
        transcribed = held.transcribed
        if held.outcome.status is not Status.SOLVED or not is_checked(transcribed.problem):
            return held
        first = best = last = self.checked(held, begin_check(transcribed, held.outcome.point, factor))
        margins, at_peaks, tried = None, True, []
        is_over = first.between is not None and first.between.is_coarse and not self.keeps_grid
        while not is_over and HELD < last.excess < np.inf and len(tried) < _MOST_TIGHTENINGS:
            assert last.check is not None
            _, shifts = excess_between(last.check, margins, at_peaks=at_peaks)
            # Margins may shrink in the first rounds; later they only grow, so that the iteration ends.
            margins = margins_for(margins, shifts, relax=at_peaks or len(tried) <= _MOST_TIGHTENINGS // 2)
            at_peaks = at_peaks and limits_beside(margins)
            local = self.search.solver.local
            local = replace(local, max_iterations=_MOST_STEPS) if at_peaks else local
            program, begun = tightened(transcribed, margins), last.outcome
            again = self.search._replace(solver=local).run(transcribed, begun.point, begun.multipliers, program)
            tried.append(again)
            if again.status is Status.INTERRUPTED:
                return last._replace(outcome=again)
            if again.status is Status.SOLVED:
                cost = cost_of_margins(transcribed, margins, first.outcome.evaluation.objective, again)
                waiting = begin_check(transcribed, again.point, factor)
                further = self.checked(held._replace(outcome=again), waiting, cost)
                if not at_peaks or further.excess <= TOLERATED:
                    # Tighter bounds may make the plan bulge more between them.
                    is_over = further.excess > best.excess and best.excess <= TOLERATED
                    best, last = further if further.excess <= best.excess else best, further
                    continue
            # Limits have kinks, at which steps shrink for ever, or another answer follows.
            is_over, at_peaks, margins, last = not at_peaks, False, None, first
        others = (one for one in (first.outcome, *tried) if one is not best.outcome)
        return best._replace(outcome=best.outcome.with_effort_of(*others))

    def _held_at_worst(self, held: Held, oracle: Oracle, factor: int) -> Held:
        """Impose limits at realisations that break them, and solve again, until none is found."""
        rounds, worst, is_found = 1, np.zeros((0, len(oracle.low))), True
        while held.outcome.status is Status.SOLVED:
            transcribed, before = held.transcribed, held.outcome
            new, worst = oracle.broken(transcribed, before, rounds)
            is_found = not len(new)
            if is_found or rounds == _MOST_SCENARIOS:
                break
            transcribed, is_found = oracle.imposed(transcribed, before, new), True
            start = transcribed.point(transcribed.decisions(before.point))
            again = self.search.run(transcribed, start, before.multipliers, goes_on=True)
            held = self._held_between(Held(transcribed, again), factor)
            held = held._replace(outcome=held.outcome.with_effort_of(before))
            rounds += 1
        worst_case = oracle.found(held.transcribed, held.outcome, worst, rounds, is_found=is_found)
        return held._replace(worst_case=worst_case)

    def _judged(self, held: Held, start: Start | None, factor: int) -> Held:
        """What was held, with the error of its grid, and what a program says that is not solved.

        - `start`: where the search began, None where the grid is not asked there.
        """
        transcribed, outcome, error, misled = held.transcribed, held.outcome, None, ""
        problem, is_solved = transcribed.problem, outcome.status is Status.SOLVED
        if outcome.failed_at is not None:
            outcome = replace(outcome, message=diagnose(transcribed, transcribed.decisions(outcome.failed_at)))
        if outcome.status in (*UNSOLVED, Status.EVALUATION_FAILED):
            said = destabilised(problem, transcribed.decisions(outcome.point))
            outcome = replace(outcome, message=f"{said} {outcome.message}".lstrip())
        if start is not None and (is_solved or outcome.status in UNSOLVED):
            misled = misled_at(transcribed, start, outcome.point if is_solved else None, factor)
            if outcome.status is Status.INFEASIBLE and not misled:
                misled = grid_error(begin_check(transcribed, outcome.point, factor)(), self.accuracy).broken
        if held.check is not None and factor > 1:
            error = grid_error(held.check, self.accuracy)
        return held._replace(outcome=outcome, error=error, misled=misled)
