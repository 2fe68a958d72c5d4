"""Designs for the worst of intervals: numbers that an opponent chooses, between two ends and without any probability.

A limit holds for all values of the intervals. The program imposes it at a few of them, the scenarios, each of which is
the same program at other numbers, so that nothing is compiled anew. Where a search over the box finds values at which a
limit, or the objective, is worse, these become scenarios too, and the program is solved again: the exchange method of
Blankenship and Falk (1976, Infinitely constrained optimization problems). The objective is the lowest level that it
exceeds nowhere, a further decision.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator.certification import (
    OWN_ERROR,
    Held,
    Margins,
    Shift,
    Shifts,
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
    with_opinion,
)
from aleator.design import Peak, Problem, declared_anew, functionals_of, value, with_simulation
from aleator.ensemble import corners_of
from aleator.nlp import HELD, AbstractSearch, Outcome, Status
from aleator.solution import Solution, WorstCase, WorstRealisation
from aleator.solving._game import LEVEL, MOST_CORNERS, Game, Scenario
from aleator.solving._stages import Stages, cost_of_margins, looked_around
from aleator.transcription import Sequential, transcribe
from aleator.uncertainty import Decision, at_values, intervals_of, with_decisions

# The most rounds.
_MOST_ROUNDS = 20


def robust(stages: Stages, problem: Problem, start: Float[np.ndarray, " n"] | None) -> Solution:
    """The solution of a problem with intervals, see `Stages.answer`: the best design for their worst values."""
    game, point = _begun(stages, problem, start)
    transcribed, scenarios = game.transcribed, game.first(point)
    outcome, margins, searched, rounds, new = None, None, 0, 0, []
    loosest = np.inf
    answer: tuple[Outcome, list[Scenario], list[Held]] | None = None
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
        new, count = game.worse(single, outcome, scenarios, rounds)
        searched += count
        if new:
            scenarios = [*scenarios, *new]
            continue
        loosest = outcome.evaluation.objective if answer is None else loosest
        cost = 0.0 if margins is None else cost_of_margins(transcribed, margins, loosest, outcome)
        held, shifts = zip(*_checked(stages, game, outcome, scenarios, cost, margins), strict=True)
        answer = outcome, scenarios, list(held)
        if not HELD < max(0.0 if one.between is None else one.between.worst for one in held) < np.inf:
            break
        margins = margins_for(margins, _largest(shifts), relax=rounds <= _MOST_ROUNDS // 2)
    assert outcome is not None
    if answer is None:  # unsolved, or not to be solved in so many rounds
        answer = outcome, scenarios, [Held(transcribed, one) for one in game.within(scenarios, outcome)]
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
    if any(isinstance(one, Peak) for one in functionals_of((problem.objective,))):
        raise ProblemError(
            "solve: the worst of an objective over intervals is no peak, whose instant may jump: minimise al.value of "
            "a level in `decisions`, and limit al.path by it."
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
    corners = corners_of(len(game.low), MOST_CORNERS, np.random.default_rng(0))
    objectives = game.beyond(game.transcribed.program, point, corners)[:, -1]
    highest = float(np.max(objectives, where=np.isfinite(objectives), initial=-np.inf))
    return begun(highest) if np.isfinite(highest) else (game, point)


def _checked(
    stages: Stages,
    game: Game,
    outcome: Outcome,
    scenarios: Sequence[Scenario],
    cost: float,
    margins: Margins | None,
) -> Iterator[tuple[Held, Shifts]]:
    """The answer in each scenario, and what limits between the instants require; `cost`: that of present margins."""
    transcribed, factor = game.transcribed, check_factor(game.problem, stages.between)
    each = [Held(transcribed, one) for one in game.within(scenarios, outcome)]
    if not is_checked(game.problem):
        yield from ((one, ()) for one in each)
        return
    for one, wait in [(one, begin_check(transcribed, one.outcome.point, factor)) for one in each]:
        check, between, shifts = wait(), None, ()
        if factor > 1 and stages.judges_between(game.problem):
            between, shifts = excess_between(check)
            is_strict = stages.between is not None or margins is not None or pieces(game.problem) > 0
            between = replace(between, is_strict=is_strict, cost=cost)
        yield one._replace(check=check, between=between), shifts


def _largest(shifts: Sequence[Shifts]) -> Shifts:
    """By how much bounds are to move for all scenarios."""
    return tuple(
        None if some[0] is None else Shift(functools.reduce(np.maximum, (one.by for one in some)), {})
        for some in zip(*shifts, strict=True)
    )


def _solution(
    stages: Stages,
    game: Game,
    outcome: Outcome,
    scenarios: Sequence[Scenario],
    answers: Sequence[Held],
    worst_case: WorstCase,
) -> Solution:
    """The solution for all scenarios: of each limit, and of the objective, that of the worst; an objection of any."""
    transcribed, each = game.transcribed, []
    if outcome.failed_at is not None:
        failed = [game.at(outcome.failed_at, one.numbers) for one in scenarios]
        broken = next((one for one in failed if not transcribed.program.evaluate(one).is_finite), failed[0])
        said = diagnose(transcribed, broken)
        answers = [one._replace(outcome=replace(one.outcome, message=said)) for one in answers]
    for one, (numbers, _) in zip(answers, scenarios, strict=True):
        check, error = one.check, None
        if check is not None and check.factor > 1:
            error = grid_error(check, stages.accuracy)
            # The objective of the program is a level, which no grid changes.
            away = float(np.max(np.abs(check.values[-1] - check.meaning.constraints[-1])))
            error = replace(error, objective=replace(error.objective, error=OWN_ERROR * away))
        each.append(game.within_problem(with_opinion(solution_of(one._replace(error=error)), one), numbers))
    highest = max(each, key=lambda one: one.objective)
    main = next((one for one in each if one.objection), highest)
    others = game.others(scenarios) if outcome.status is Status.SOLVED else []
    further = [
        replace(game.within_problem(solution_of(Held(transcribed, own)), one.numbers), effort=main.effort)
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
        over_intervals=(*each, *(replace(one, certificate=main.certificate) for one in further)),
    )
