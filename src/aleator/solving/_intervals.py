"""Designs for the worst of intervals: numbers that an opponent chooses, between two ends and without any probability.

A limit holds for all values of the intervals. The program imposes it at a few of them, the scenarios, each of which is
the same program at other numbers, so that nothing is compiled anew. Where a search over the box finds values at which a
limit, or the objective, is worse, these become scenarios too, and the program is solved again: the exchange method of
Blankenship and Falk (1976, Infinitely constrained optimization problems). The objective is the lowest level that it
exceeds nowhere, a further decision.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.errors import ProblemError
from aleator.certification._between import (
    Shift,
    cost_of_margins,
    excess_between,
    margins_for,
    tightened,
)
from aleator.certification._check import begin_check
from aleator.certification._grids import OWN_ERROR, grid_error
from aleator.certification._judgement import Held, diagnose, solution_of, with_opinion
from aleator.certification._systems import check_factor, is_checked, prepare_check
from aleator.certification._worst_case import worth_imposing
from aleator.design import Peak, Problem, declared_anew, functionals_of, in_quantiles, value, with_simulation
from aleator.ensemble import corners_of, spread_over
from aleator.nlp import HELD, AbstractSearch, Evaluation, NonlinearProgram, Outcome, Status
from aleator.solution import Solution, WorstCase, WorstRealisation
from aleator.solving._search import UNSOLVED, looked_around
from aleator.solving._stages import Stages
from aleator.transcription import AbstractTranscribed, Remembered, Sequential, rows_by_name, transcribe
from aleator.uncertainty import Decision, at_values, intervals_of, with_decisions

# The decision that is the objective's level, and the limit that holds it there.
_LEVEL = "objective.worst"
# The most rounds, and the most corners of the intervals that are tried at the start.
_MOST_ROUNDS, _MOST_CORNERS = 20, 128
# Values closer than this part of the box are the same.
_SAME = 1e-3
# Corners, and random points inside, at which a design is shown besides its scenarios.
_SHOWN_CORNERS, _SHOWN_INSIDE = 16, 2


class Scenario(NamedTuple):
    """Values of the intervals, and which limits are imposed there; the last limit is that of the objective."""

    numbers: Float[np.ndarray, " intervals"]
    imposed: Bool[np.ndarray, " limits"]


@final
@dataclass(frozen=True)
class Game:
    """A problem whose intervals an opponent chooses.

    - `problem`: as it was declared; `transcribed`: with a level of the objective, and intervals as free decisions;
    - `names`: of the intervals, which stand at `where` among its variables; `low`, `high`: their ends.
    """

    problem: Problem
    transcribed: AbstractTranscribed
    names: list[str]
    where: list[int]
    low: Float[np.ndarray, " intervals"]
    high: Float[np.ndarray, " intervals"]

    def numbers(self, points: Float[np.ndarray, "*some intervals"]) -> Float[np.ndarray, "*some intervals"]:
        """Points of the unit box as values of the intervals."""
        return self.low + points * (self.high - self.low)

    def at(self, point: Float[np.ndarray, " n"], numbers: Float[np.ndarray, "*some intervals"]) -> np.ndarray:
        """The variables with other values of the intervals."""
        moved = np.broadcast_to(point, (*numbers.shape[:-1], len(point))).copy()
        moved[..., self.where] = numbers
        return moved

    def rows(self, scenario: Scenario) -> Int[np.ndarray, " rows"]:
        """The rows of the limits that are imposed in a scenario."""
        parts = zip(self.transcribed.rows, scenario.imposed, strict=True)
        return np.flatnonzero(np.concatenate([np.full(rows.stop - rows.start, own) for rows, own in parts]))

    def groups(self, scenarios: Sequence[Scenario]) -> list[tuple[Int[np.ndarray, " rows"], float]]:
        """The rows of each name of limits in all scenarios together, with their size."""
        every = np.concatenate(list(map(self.rows, scenarios)))
        return [(np.flatnonzero(np.isin(every, rows)), size) for rows, size in rows_by_name(self.transcribed)]

    def program(self, single: NonlinearProgram, scenarios: Sequence[Scenario]) -> NonlinearProgram:
        """The limits of some scenarios in one program, in which the intervals are no variables: they are fixed.

        `single`: the program of one scenario.
        """
        rows = list(map(self.rows, scenarios))

        def together(of: Any) -> np.ndarray:
            return np.concatenate([of[one] for one in rows])

        @Remembered
        def each(point: Float[np.ndarray, " n"]) -> list[Evaluation]:
            return [single.evaluate(self.at(point, one.numbers)) for one in scenarios]

        def evaluate(point: Float[np.ndarray, " n"]) -> Evaluation:
            every = each(point)
            parts = [(one.constraints[some], one.jacobian[some]) for one, some in zip(every, rows, strict=True)]
            constraints, jacobian = map(np.concatenate, zip(*parts, strict=True))
            jacobian[:, self.where] = 0.0
            return Evaluation(every[0].objective, every[0].gradient, constraints, jacobian)

        def sizes(point: Float[np.ndarray, " n"], evaluation: Evaluation) -> Float[np.ndarray, " rows"]:
            del evaluation  # of all scenarios
            assert single.sizes is not None
            parts = zip(scenarios, each(point), rows, strict=True)
            return np.concatenate([single.sizes(self.at(point, one.numbers), own)[some] for one, own, some in parts])

        lower, upper = single.lower.copy(), single.upper.copy()
        lower[self.where] = upper[self.where] = single.start[self.where]
        return replace(
            single,
            evaluate=evaluate,
            lower=lower,
            upper=upper,
            constraint_lower=together(single.constraint_lower),
            constraint_upper=together(single.constraint_upper),
            constraint_scale=together(single.constraint_scale),
            sparsity=None if single.sparsity is None else together(single.sparsity),
            hessian=None,
            sizes=sizes,
            values=None,
        )

    def beyond(
        self, single: NonlinearProgram, point: Float[np.ndarray, " n"], points: Float[np.ndarray, "points intervals"]
    ) -> Float[np.ndarray, "points limits"]:
        """The excess over each limit at points of the unit box; NaN where there is no value."""
        assert single.values is not None
        excess = single.limits.excess(single.values(self.at(point, self.numbers(points)))[1])
        return np.stack([excess[:, rows].max(axis=1) for rows in self.transcribed.rows], axis=1)

    def first(self, point: Float[np.ndarray, " n"]) -> list[Scenario]:
        """Scenarios to begin with: for each limit the corner at which it is worst."""
        corners = corners_of(len(self.low), _MOST_CORNERS, np.random.default_rng(0))
        worst = np.argmax(np.nan_to_num(self.beyond(self.transcribed.program, point, corners), nan=-np.inf), axis=0)
        return [Scenario(self.numbers(corners[k]), worst == k) for k in np.unique(worst)]

    def worse(
        self, single: NonlinearProgram, outcome: Outcome, scenarios: Sequence[Scenario], seed: int
    ) -> tuple[list[Scenario], int]:
        """Scenarios that break a limit by more than the present ones do, and how many values were tried."""
        held, count = [(one.numbers - self.low) / (self.high - self.low) for one in scenarios], 0
        candidates = np.concatenate([np.stack(held), spread_over(len(self.low), seed)])

        def excess_at(points: Float[np.ndarray, "points intervals"]) -> Float[np.ndarray, "points limits"]:
            nonlocal count
            count += len(points)
            return self.beyond(single, outcome.point, points)

        # The largest size of each limit, wherever it is imposed.
        own = np.zeros(len(single.constraint_lower))
        np.maximum.at(own, np.concatenate(list(map(self.rows, scenarios))), outcome.sizes)
        sizes = np.array([own[rows].max(initial=0.0) for rows in self.transcribed.rows])
        imposed = np.stack([one.imposed for one in scenarios])
        new, _ = worth_imposing(excess_at, candidates, imposed, sizes, seed)
        limits = np.arange(len(new))
        return [
            Scenario(self.numbers(one), limits == i)
            for i, some in enumerate(new)
            for k, one in enumerate(some)
            if all(np.max(np.abs(one - other)) > _SAME for other in some[:k])
        ], count

    def within(self, scenarios: Sequence[Scenario], outcome: Outcome) -> Iterator[Outcome]:
        """The outcome in each scenario alone, with its share of the multipliers; of none, where it was added later."""
        single, last = self.transcribed.program, 0
        assert single.sizes is not None
        for one in scenarios:
            point, rows = self.at(outcome.point, one.numbers), self.rows(one)
            own, some = single.evaluate(point), slice(last, last := last + len(rows))
            multipliers, active = np.zeros(len(own.constraints)), np.zeros(len(own.constraints), dtype=bool)
            if last <= len(outcome.multipliers):
                multipliers[rows], active[rows] = outcome.multipliers[some], outcome.active[some]
            parts = {"multipliers": multipliers, "active": active, "sizes": single.sizes(point, own)}
            yield replace(outcome, point=point, evaluation=own, **parts)

    def solution(self, held: Held, numbers: Float[np.ndarray, " intervals"], *, judged: bool) -> Solution:
        """The solution in a scenario as that of the problem in which the intervals have these values.

        `judged`: whether it is confirmed by fresh systems.
        """
        whole, others = solution_of(held), {*self.names, _LEVEL}
        whole = with_opinion(whole, held) if judged else whole
        values = dict(zip(self.names, numbers.tolist(), strict=True))
        decisions, bound_multipliers = (
            {name: one for name, one in named.items() if name not in others}
            for named in (whole.decisions, whole.bound_multipliers)
        )
        return replace(
            whole,
            problem=with_simulation(self.problem, at_values(self.problem.simulation, values)),
            objective=whole.decisions[_LEVEL] + float(whole.constraints[-1].excess.max()),
            decisions=decisions,
            vector=np.delete(whole.vector, self.transcribed.places.decisions[_LEVEL].where.start),
            constraints=whole.constraints[:-1],
            at_bounds=tuple(name for name in whole.at_bounds if name not in others),
            idle=tuple(name for name in whole.idle if name not in others),
            multipliers=whole.multipliers[: self.transcribed.rows[-1].start],
            bound_multipliers=bound_multipliers,
        )

    def others(self, scenarios: Sequence[Scenario]) -> list[Scenario]:
        """Corners and points inside that are no scenarios, with nothing imposed."""
        generator, count = np.random.default_rng(0), len(self.low)
        corners = corners_of(count, _SHOWN_CORNERS, generator)
        points = self.numbers(np.concatenate([corners, generator.random((_SHOWN_INSIDE, count))]))
        known = {one.numbers.tobytes() for one in scenarios}
        none = np.zeros(len(self.transcribed.rows), dtype=bool)
        return [Scenario(one, none) for one in points if one.tobytes() not in known]


def robust(stages: Stages, problem: Problem, start: Float[np.ndarray, " n"] | None) -> Solution:
    """The solution of a problem with intervals, see `Stages.answer`: the best design for their worst values."""
    game, point = _begun(stages, problem, start)
    transcribed, scenarios = game.transcribed, game.first(point)
    outcome, margins, loosest, searched, rounds, new = None, None, np.inf, 0, 0, []
    answer: tuple[Outcome, list[Scenario], list[Held]] | None = None
    while rounds < _MOST_ROUNDS:
        rounds += 1
        single = transcribed.program if margins is None else tightened(transcribed, margins)
        joint = replace(transcribed, program=game.program(single, scenarios))
        again = stages.search.run(joint, point, None, goes_on=outcome is not None)
        if again.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        again = looked_around(joint, stages.search.solver.local, again, point) if outcome is None else again
        if again.status in UNSOLVED and again.violation > HELD:
            again = stages.search.by_least_excess(joint, again, joint, game.groups(scenarios))
        outcome = again if outcome is None else again.with_effort_of(outcome)
        if outcome.status is not Status.SOLVED:
            break
        point = outcome.point
        new, count = game.worse(single, outcome, scenarios, rounds)
        searched += count
        if new:
            scenarios = [*scenarios, *new]
            continue
        loosest = outcome.evaluation.objective if answer is None else loosest
        cost = None if margins is None else cost_of_margins(transcribed, margins, loosest, outcome)
        held = [Held(transcribed, one) for one in game.within(scenarios, outcome)]
        held = list(_checked(stages, game, held, cost)) if is_checked(problem) else held
        answer = outcome, scenarios, held
        if not HELD < max(one.excess for one in held) < np.inf:
            break
        # By how much bounds are to move for all scenarios.
        shifts = (excess_between(one.check)[1] for one in held if one.check is not None)
        moved = (
            None if some[0] is None else Shift(functools.reduce(np.maximum, (one.by for one in some if one)), {})
            for some in zip(*shifts, strict=True)
        )
        margins = margins_for(margins, tuple(moved), relax=rounds <= _MOST_ROUNDS // 2)
    assert outcome is not None
    if answer is None:  # unsolved, or not to be solved in so many rounds
        answer = outcome, scenarios, [Held(transcribed, one) for one in game.within(scenarios, outcome)]
    is_found = outcome.status is not Status.SOLVED or not new
    worst_case = WorstCase((), np.zeros((0, 0)), rounds, searched, is_found, "values of the intervals")
    return _solution(game, *answer, worst_case)


def _begun(
    stages: Stages, problem: Problem, start: Float[np.ndarray, " n"] | None
) -> tuple[Game, Float[np.ndarray, " n"]]:
    """The game of a problem, and its variables at the start, the level there being that of the worst corner."""
    names = [*intervals_of(problem.placements)]
    if not isinstance(stages.transcription, Sequential) or isinstance(stages.search.solver, AbstractSearch):
        raise ProblemError(
            f"solve: '{names[0]}' is an al.Interval, for whose worst values limits are added from round to round: "
            "expected transcription=al.Sequential() and a solver by derivatives, such as al.solvers.FilterSQP()."
        )
    if any(isinstance(one, Peak) for one in functionals_of((problem.objective,))):
        raise ProblemError(
            "solve: the worst of an objective over intervals is no peak, whose instant may jump: minimise al.value of "
            "a level in `decisions`, and limit al.path by it."
        )
    limit = (problem.objective - value(_LEVEL) <= 0.0).named(_LEVEL)
    limits, level = (*problem.constraints, limit), {_LEVEL: Decision(0.0)}
    whole = declared_anew(problem, problem.simulation, minimize=value(_LEVEL), subject_to=limits, decisions=level)
    whole = in_quantiles(whole)
    free, prepare = at_values(whole.simulation), functools.partial(prepare_check, check_factor(problem, stages.between))

    def begun(level: float) -> tuple[Game, Float[np.ndarray, " n"]]:
        simulation = with_decisions(free, lambda name, one: Decision(level) if name == _LEVEL else one)
        transcribed = transcribe(with_simulation(whole, simulation), stages.transcription, prepare)
        decisions = transcribed.places.decisions
        where = [decisions[name].where.start for name in names]
        low, high = (transcribed.places.vector(end)[where] for end in ("lower", "upper"))
        game, of_level = Game(problem, transcribed, names, where, low, high), decisions[_LEVEL].where.start
        return game, transcribed.program.start if start is None else np.insert(start, of_level, level)

    game, point = begun(0.0)
    corners = corners_of(len(game.low), _MOST_CORNERS, np.random.default_rng(0))
    objectives = game.beyond(game.transcribed.program, point, corners)[:, -1]
    highest = float(np.max(objectives, where=np.isfinite(objectives), initial=-np.inf))
    return begun(highest) if np.isfinite(highest) else (game, point)


def _checked(stages: Stages, game: Game, each: list[Held], cost: float | None) -> Iterator[Held]:
    """The answer in each scenario with its check; `cost`: that of present margins, None without any."""
    factor = check_factor(game.problem, stages.between)
    for one, waiting in [(one, begin_check(game.transcribed, one.outcome.point, factor)) for one in each]:
        held, error = stages.checked(one, waiting, cost), None
        check = held.check
        if check is not None and factor > 1:
            error = grid_error(check, stages.accuracy)
            # The objective of the program is a level, which no grid changes.
            away = float(np.max(np.abs(check.values[-1] - check.meaning.constraints[-1])))
            error = replace(error, objective=replace(error.objective, error=OWN_ERROR * away))
        yield held._replace(error=error)


def _solution(
    game: Game,
    outcome: Outcome,
    scenarios: Sequence[Scenario],
    answers: Sequence[Held],
    worst_case: WorstCase,
) -> Solution:
    """The solution for all scenarios: of each limit, and of the objective, that of the worst; an objection of any."""
    transcribed, names = game.transcribed, game.names
    if outcome.failed_at is not None:
        failed = [game.at(outcome.failed_at, one.numbers) for one in scenarios]
        broken = next((one for one in failed if not transcribed.program.evaluate(one).is_finite), failed[0])
        said = diagnose(transcribed, broken)
        answers = [one._replace(outcome=replace(one.outcome, message=said)) for one in answers]
    each = [game.solution(one, own.numbers, judged=True) for one, own in zip(answers, scenarios, strict=True)]
    highest = max(each, key=lambda one: one.objective)
    main = next((one for one in each if one.objection), highest)

    def realisation(name: str, text: str, worst: tuple[float, float, float | None], scenario: Scenario) -> Any:
        return WorstRealisation(name, text, *worst, dict(zip(names, scenario.numbers.tolist(), strict=True)))

    results, realisations = [], []
    for i in range(len(game.problem.constraints)):
        parts = zip(each, scenarios, strict=True)
        imposed = [(one.constraints[i], scenario) for one, scenario in parts if scenario.imposed[i]]
        worst, scenario = max(imposed, key=lambda pair: float(pair[0].excess.max()))
        multipliers = sum((one.multipliers for one, _ in imposed), start=np.zeros_like(worst.multipliers))
        active = np.any([one.active for one, _ in imposed], axis=0)
        results.append(replace(worst, multipliers=multipliers, active=active))
        at = worst.worst, float(worst.excess.max()), worst.worst_time
        realisations.append(realisation(worst.name, worst.text, at, scenario))
    at = highest.objective, 0.0, None
    realisations.append(realisation("the objective", str(game.problem.objective), at, scenarios[each.index(highest)]))
    numbers = np.stack([one.numbers for one in scenarios])
    worst_case = replace(worst_case, realisations=tuple(realisations), scenarios=numbers)
    others = game.others(scenarios) if outcome.status is Status.SOLVED else []
    further = (
        game.solution(Held(transcribed, own), one.numbers, judged=False)
        for one, own in zip(others, game.within(others, outcome), strict=True)
    )
    return replace(
        main,
        problem=game.problem,
        objective=highest.objective,
        constraints=tuple(results),
        certificate=replace(main.certificate, worst_case=worst_case),
        over_intervals=(*each, *(replace(one, certificate=main.certificate, effort=main.effort) for one in further)),
    )
