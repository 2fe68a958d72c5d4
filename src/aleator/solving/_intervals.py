"""Designs for the worst of intervals: numbers that an opponent chooses, between two ends and without any probability.

A limit holds for all values of the intervals. The program imposes it at a few of them, the scenarios, each of which is
the same program at other numbers, so that nothing is compiled anew. Where a search over the box finds values at which a
limit, or the objective, is worse, these become scenarios too, and the program is solved again: the exchange method of
Blankenship and Falk (1976, Infinitely constrained optimization problems). The objective is the lowest level that it
exceeds nowhere, a further decision.
"""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from aleator._core.errors import ProblemError
from aleator.certification import (
    Check,
    Margins,
    begin_check,
    check_factor,
    diagnose,
    excess_between,
    grid_error,
    is_checked,
    margins_for,
    pieces,
    prepare_check,
    solution_of,
    tightened,
    worth_imposing,
)
from aleator.design import Problem, declared_anew, value
from aleator.ensemble import corners_of, search, spread_over
from aleator.nlp import HELD, AbstractSearch, Evaluation, NonlinearProgram, Outcome, Status
from aleator.solution import Between, Solution, WorstCase, WorstRealisation
from aleator.solving._stages import Held, Stages, looked_around, with_opinion
from aleator.transcription import AbstractTranscribed, Remembered, Sequential, transcribe
from aleator.uncertainty import Decision, at_values, intervals_of, with_decisions

LEVEL = "objective.worst"

# The most rounds, and the most corners that are tried at the start.
_MOST_ROUNDS, _MOST_CORNERS = 20, 128
# Values closer than this part of the box are the same.
_SAME = 1e-3
# Corners, and random points inside, at which a design is told besides its scenarios.
_TOLD_CORNERS, _TOLD_INSIDE = 16, 2


class Scenario(NamedTuple):
    """Values of the intervals, and which limits are imposed there; the last limit is that of the objective."""

    numbers: Float[np.ndarray, " intervals"]
    imposed: Bool[np.ndarray, " limits"]


@final
@dataclass(frozen=True)
class Game:
    """A problem whose intervals an opponent chooses.

    - `problem`: as it was declared; `transcribed`: with a level of the objective, and intervals as free decisions;
    - `where`: the intervals among its variables, by name; `low`, `high`: their ends.
    """

    problem: Problem
    transcribed: AbstractTranscribed
    where: dict[str, int]
    low: Float[np.ndarray, " intervals"]
    high: Float[np.ndarray, " intervals"]

    @classmethod
    def of(cls, problem: Problem, transcribed: AbstractTranscribed) -> "Game":
        """That of a problem and its program."""
        decisions = transcribed.places.decisions
        where = {name: decisions[name].where.start for name in intervals_of(problem.placements)}
        low, high = (transcribed.places.vector(end)[[*where.values()]] for end in ("lower", "upper"))
        return cls(problem, transcribed, where, low, high)

    def numbers(self, points: Float[np.ndarray, "points intervals"]) -> Float[np.ndarray, "points intervals"]:
        """Points of the unit box as values of the intervals."""
        return self.low + points * (self.high - self.low)

    def named(self, numbers: Float[np.ndarray, " intervals"]) -> dict[str, float]:
        """Values of the intervals by name."""
        return dict(zip(self.where, numbers.tolist(), strict=True))

    @property
    def level(self) -> int:
        """The place of the objective's level among the variables."""
        return self.transcribed.places.decisions[LEVEL].where.start

    def at(self, point: Float[np.ndarray, " n"], numbers: Float[np.ndarray, "*some intervals"]) -> np.ndarray:
        """The variables with other values of the intervals."""
        moved = np.broadcast_to(point, (*numbers.shape[:-1], len(point))).copy()
        moved[..., [*self.where.values()]] = numbers
        return moved

    def rows(self, scenario: Scenario) -> Int[np.ndarray, " rows"]:
        """The rows of the limits that are imposed in a scenario."""
        parts = zip(self.transcribed.rows, scenario.imposed, strict=True)
        return np.flatnonzero(np.concatenate([np.full(rows.stop - rows.start, own) for rows, own in parts]))

    def program(self, single: NonlinearProgram, scenarios: Sequence[Scenario]) -> NonlinearProgram:
        """The limits of some scenarios in one program, in which the intervals are no variables: they are fixed.

        `single`: the program of one scenario.
        """
        rows, where = list(map(self.rows, scenarios)), [*self.where.values()]

        def together(of: Any) -> np.ndarray:
            return np.concatenate([of[one] for one in rows])

        @Remembered
        def each(point: Float[np.ndarray, " n"]) -> list[Evaluation]:
            return [single.evaluate(self.at(point, one.numbers)) for one in scenarios]

        def evaluate(point: Float[np.ndarray, " n"]) -> Evaluation:
            parts = list(zip(each(point), rows, strict=True))
            jacobian = np.concatenate([one.jacobian[some] for one, some in parts])
            jacobian[:, where] = 0.0
            constraints = np.concatenate([one.constraints[some] for one, some in parts])
            return Evaluation(parts[0][0].objective, parts[0][0].gradient, constraints, jacobian)

        def sizes(point: Float[np.ndarray, " n"], evaluation: Evaluation) -> Float[np.ndarray, " rows"]:
            del evaluation  # of all scenarios
            parts = zip(scenarios, each(point), rows, strict=True)
            return np.concatenate([single.sizes(self.at(point, one.numbers), own)[some] for one, own, some in parts])

        lower, upper = single.lower.copy(), single.upper.copy()
        lower[where] = upper[where] = single.start[where]
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
        _, values = single.values(self.at(point, self.numbers(points)))
        excess = single.limits.excess(values)
        return np.stack([excess[:, rows].max(axis=1) for rows in self.transcribed.rows], axis=1)

    def tried(self, scenarios: Sequence[Scenario], seed: int) -> Float[np.ndarray, "points intervals"]:
        """Points of the unit box at which a search begins, the scenarios first."""
        held = [(one.numbers - self.low) / (self.high - self.low) for one in scenarios]
        return np.concatenate([np.stack(held), spread_over(len(self.low), seed)])

    def first(self, point: Float[np.ndarray, " n"]) -> list[Scenario]:
        """Scenarios to begin with: for each limit the corner at which it is worst."""
        corners = corners_of(len(self.low), _MOST_CORNERS, np.random.default_rng(0))
        beyond = np.nan_to_num(self.beyond(self.transcribed.program, point, corners), nan=-np.inf)
        worst = np.argmax(beyond, axis=0)
        return [Scenario(self.numbers(corners[k]), worst == k) for k in np.unique(worst)]

    def worse(
        self, single: NonlinearProgram, outcome: Outcome, scenarios: Sequence[Scenario], seed: int
    ) -> tuple[list[Scenario], int]:
        """Scenarios that break a limit by more than the present ones do, and how many values were tried."""
        tried, count = self.tried(scenarios, seed), 0

        def excess_at(points: Float[np.ndarray, "points intervals"]) -> Float[np.ndarray, "points limits"]:
            nonlocal count
            count += len(points)
            return self.beyond(single, outcome.point, points)

        beyond = excess_at(tried)
        imposed = np.stack([one.imposed for one in scenarios])
        held = np.where(imposed, beyond[: len(scenarios)], -np.inf).max(axis=0)
        sizes, ends = np.zeros(imposed.shape[1]), np.cumsum([0, *(len(self.rows(one)) for one in scenarios)])
        for scenario, first, last in zip(scenarios, *(ends[:-1], ends[1:]), strict=True):
            own = np.zeros(len(single.constraint_lower))
            own[self.rows(scenario)] = outcome.sizes[first:last]
            sizes = np.maximum(sizes, [own[rows].max(initial=0.0) for rows in self.transcribed.rows])
        allowed = np.maximum(held, 0.0) + HELD / 2 * sizes
        new = worth_imposing(search(excess_at, tried, beyond, seed), allowed)
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
        for one in scenarios:
            point, rows = self.at(outcome.point, one.numbers), self.rows(one)
            own, last = single.evaluate(point), last + len(rows)
            multipliers, active = np.zeros(len(own.constraints)), np.zeros(len(own.constraints), dtype=bool)
            if last <= len(outcome.multipliers):
                some = slice(last - len(rows), last)
                multipliers[rows], active[rows] = outcome.multipliers[some], outcome.active[some]
            parts = {"multipliers": multipliers, "active": active, "sizes": single.sizes(point, own)}
            yield replace(outcome, point=point, evaluation=own, **parts)

    def told(self, solution: Solution, numbers: Float[np.ndarray, " intervals"]) -> Solution:
        """The solution in a scenario as that of the problem in which the intervals have these values."""
        others = {*self.where, LEVEL}

        def without(named: Mapping[str, Any]) -> dict[str, Any]:
            return {name: one for name, one in named.items() if name not in others}

        return replace(
            solution,
            problem=with_simulation(self.problem, at_values(self.problem.simulation, self.named(numbers))),
            objective=solution.decisions[LEVEL] + float(solution.constraints[-1].excess.max()),
            decisions=without(solution.decisions),
            vector=np.delete(solution.vector, self.level),
            constraints=solution.constraints[:-1],
            at_bounds=tuple(name for name in solution.at_bounds if name not in others),
            idle=tuple(name for name in solution.idle if name not in others),
            multipliers=solution.multipliers[: self.transcribed.rows[-1].start],
            bound_multipliers=without(solution.bound_multipliers),
        )

    def others(self, scenarios: Sequence[Scenario]) -> list[Scenario]:
        """Corners and points inside that are no scenarios, with nothing imposed."""
        generator, count = np.random.default_rng(0), len(self.low)
        corners = corners_of(count, _TOLD_CORNERS, generator)
        points = self.numbers(np.concatenate([corners, generator.random((_TOLD_INSIDE, count))]))
        known = {one.numbers.tobytes() for one in scenarios}
        none = np.zeros(len(self.transcribed.rows), dtype=bool)
        return [Scenario(one, none) for one in points if one.tobytes() not in known]


class Checked(NamedTuple):
    """An answer in one scenario, checked: see `Held`; `shifts`: what its limits between the instants require."""

    outcome: Outcome
    check: Check | None = None
    between: Between | None = None
    shifts: Margins = ()


def robust(stages: Stages, problem: Problem, start: Float[np.ndarray, " n"] | None) -> Solution:
    """The solution of a problem with intervals, see `Stages.answer`: the best design for their worst values."""
    game, point = _begun(stages, problem, start)
    transcribed, scenarios = game.transcribed, game.first(point)
    outcome, margins, searched, rounds = None, None, 0, 0
    answer: tuple[Outcome, list[Scenario], list[Checked]] | None = None
    while rounds < _MOST_ROUNDS:
        rounds += 1
        single = transcribed.program if margins is None else tightened(transcribed, margins)
        joint = replace(transcribed, program=game.program(single, scenarios))
        again = stages.searched(joint, point, None, goes_on=outcome is not None)
        if again.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        again = looked_around(joint, stages.solver.local, again, point) if outcome is None else again
        outcome = again if outcome is None else again.with_effort_of(outcome)
        if outcome.status is not Status.SOLVED:
            break
        point = outcome.point
        new, tried = game.worse(single, outcome, scenarios, rounds)
        searched += tried
        if new:
            scenarios = [*scenarios, *new]
            continue
        checks = list(_checked(stages, game, outcome, scenarios))
        answer, shifts = (outcome, scenarios, checks), _shifts(checks, scenarios)
        if shifts is None:
            break
        margins = margins_for(margins, shifts, relax=rounds <= _MOST_ROUNDS // 2)
    assert outcome is not None
    if answer is None:  # unsolved, or not to be solved in so many rounds
        answer = outcome, scenarios, [Checked(one) for one in game.within(scenarios, outcome)]
    is_found = outcome.status is not Status.SOLVED or not new
    worst_case = WorstCase((), np.zeros((0, 0)), rounds, searched, is_found, "values of the intervals")
    return _solution(stages, game, *answer, worst_case)


def _begun(
    stages: Stages, problem: Problem, start: Float[np.ndarray, " n"] | None
) -> tuple[Game, Float[np.ndarray, " n"]]:
    """The game of a problem, and its variables at the start, the level there being that of the worst corner."""
    if not isinstance(stages.transcription, Sequential) or isinstance(stages.solver, AbstractSearch):
        raise ProblemError(
            f"solve: '{next(iter(intervals_of(problem.placements)))}' is an al.Interval, for whose worst values limits "
            "are added from round to round: expected transcription=al.Sequential() and a solver by derivatives, such "
            "as al.solvers.FilterSQP()."
        )
    limit = (problem.objective - value(LEVEL) <= 0.0).named(LEVEL)
    whole = declared_anew(
        problem,
        problem.simulation,
        minimize=value(LEVEL),
        subject_to=(*problem.constraints, limit),
        decisions={LEVEL: Decision(0.0)},
    )
    free, prepare = at_values(whole.simulation), functools.partial(prepare_check, check_factor(problem, stages.between))

    def begun(level: float) -> tuple[Game, Float[np.ndarray, " n"]]:
        simulation = with_decisions(free, lambda name, one: Decision(level) if name == LEVEL else one)
        game = Game.of(problem, transcribe(with_simulation(whole, simulation), stages.transcription, prepare))
        return game, game.transcribed.program.start if start is None else np.insert(start, game.level, level)

    game, point = begun(0.0)
    corners = corners_of(len(game.low), _MOST_CORNERS, np.random.default_rng(0))
    objectives = game.beyond(game.transcribed.program, point, corners)[:, -1]
    highest = float(np.max(objectives, where=np.isfinite(objectives), initial=-np.inf))
    return begun(highest) if np.isfinite(highest) else (game, point)


def _checked(stages: Stages, game: Game, outcome: Outcome, scenarios: Sequence[Scenario]) -> Iterator[Checked]:
    """The answer in each scenario."""
    transcribed, factor = game.transcribed, check_factor(game.problem, stages.between)
    each = list(game.within(scenarios, outcome))
    if not is_checked(game.problem):
        yield from map(Checked, each)
        return
    for one, wait in [(one, begin_check(transcribed, one.point, factor)) for one in each]:
        check = wait()
        if factor == 1 or not stages.judges_between(game.problem):
            yield Checked(one, check)
            continue
        between, shifts = excess_between(transcribed, one.point, check)
        is_strict = stages.between is not None or pieces(game.problem) > 0
        yield Checked(one, check, replace(between, is_strict=is_strict), shifts)


def _shifts(checks: Sequence[Checked], scenarios: Sequence[Scenario]) -> Margins | None:
    """By how much bounds are to move so that limits hold between the instants too; None where they do."""
    if not HELD < max(0.0 if one.between is None else one.between.worst for one in checks) < np.inf:
        return None
    limits = zip(*(one.shifts for one in checks), np.stack([one.imposed for one in scenarios]).T, strict=True)
    imposed = [[*itertools.compress(shifts, own)] for *shifts, own in limits]
    return tuple(None if some[0] is None else functools.reduce(np.maximum, some) for some in imposed)


def _solution(
    stages: Stages,
    game: Game,
    outcome: Outcome,
    scenarios: Sequence[Scenario],
    checks: Sequence[Checked],
    worst_case: WorstCase,
) -> Solution:
    """The solution for all scenarios: of each limit, and of the objective, that of the worst; an objection of any."""
    transcribed, each = game.transcribed, []
    if outcome.failed_at is not None:
        failed = [game.at(outcome.failed_at, one.numbers) for one in scenarios]
        broken = next((one for one in failed if not transcribed.program.evaluate(one).is_finite), failed[0])
        checks = [one._replace(outcome=replace(one.outcome, message=diagnose(transcribed, broken))) for one in checks]
    for one, (numbers, _) in zip(checks, scenarios, strict=True):
        point, check = one.outcome.point, one.check
        error = None
        if check is not None and check.factor > 1:
            error = grid_error(transcribed, point, check, stages.accuracy)
        solution = solution_of(transcribed, one.outcome, one.between, error, None, "", check)
        solution = with_opinion(solution, Held(transcribed, one.outcome, one.between, check))
        each.append(game.told(solution, numbers))
    highest = max(each, key=lambda one: one.objective)
    main = next((one for one in each if one.objection), highest)
    others = game.others(scenarios) if outcome.status is Status.SOLVED else []
    told = [
        replace(game.told(solution_of(transcribed, own, None, None, None, "", None), one.numbers), effort=main.effort)
        for one, own in zip(others, game.within(others, outcome), strict=True)
    ]
    results, realisations = [], []
    for i in range(len(game.problem.constraints)):
        parts = zip(each, scenarios, strict=True)
        imposed = [(one.constraints[i], scenario) for one, scenario in parts if scenario.imposed[i]]
        worst, scenario = max(imposed, key=lambda pair: float(pair[0].excess.max()))
        multipliers = sum((one.multipliers for one, _ in imposed), start=np.zeros_like(worst.multipliers))
        active = np.any([one.active for one, _ in imposed], axis=0)
        results.append(replace(worst, multipliers=multipliers, active=active))
        realisations.append(
            WorstRealisation(
                name=worst.name,
                text=worst.text,
                value=worst.worst,
                beyond=float(worst.excess.max()),
                time=worst.worst_time,
                numbers=game.named(scenario.numbers),
            )
        )
    numbers = game.named(scenarios[each.index(highest)].numbers)
    objective = WorstRealisation("the objective", str(game.problem.objective), highest.objective, 0.0, None, numbers)
    worst_case = replace(
        worst_case,
        realisations=(*realisations, objective),
        scenarios=np.stack([one.numbers for one in scenarios]),
    )
    return replace(
        main,
        problem=game.problem,
        objective=highest.objective,
        constraints=tuple(results),
        certificate=replace(main.certificate, worst_case=worst_case),
        over_intervals=(*each, *(replace(one, certificate=main.certificate) for one in told)),
    )


def with_simulation(problem: Problem, simulation: Any) -> Problem:
    """The problem with another simulation of the same equations."""
    return eqx.tree_at(lambda one: one.simulation, problem, simulation)
