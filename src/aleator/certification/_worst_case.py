"""Limits on the worst case of the model itself, found by a search over its realisations, not by its expansion."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from aleator.certification._oracle import Oracle, worst_case_limits
from aleator.certification._search import Points, candidates, search
from aleator.design import AbstractFunctional, Constraint, functionals_of, is_worst_case
from aleator.ensemble import inputs_at
from aleator.nlp import HELD, Outcome, Status
from aleator.solution import WorstCase, WorstRealisation
from aleator.transcription import AbstractTranscribed, Scenarios

# How often scenarios are added and the program is solved again at most.
_MOST_ROUNDS = 20
# The most new scenarios per limit and round, and the least excess of a new one, relative to the worst.
_NEW, _WORTH = 2, 0.3
# Slack beyond this part of the scale makes a scenario idle.
_IDLE = 1e-3
# Instants at which the expansion ranks realisations, and how many of these it names.
_RANKED_INSTANTS, _RANKED = 200, 16

T = TypeVar("T")

Attempt: TypeAlias = Callable[[AbstractTranscribed, np.ndarray | None, np.ndarray | None], tuple[Outcome, T]]
"""Solves a transcribed problem from a start with multipliers, if they fit; returns the outcome and further results."""


def held_at_worst(
    transcribed: AbstractTranscribed,
    attempt: Attempt[T],
    again: Attempt[T],
    start: np.ndarray | None,
    multipliers: np.ndarray | None,
    *,
    factor: int,
    known: WorstCase | None,
) -> tuple[AbstractTranscribed, Outcome, T, WorstCase | None]:
    """Solve, search for realisations that break a limit on the worst case, impose the limits there, and solve again.

    - `attempt`: the first solve; `again`: those that continue from an answer;
    - `factor`: how many times as many steps the grid has on which realisations are judged; `known`: the worst case of
      an earlier solution, whose scenarios are the first.

    Returns the program that was solved last, its outcome with the further results of `attempt`, and the worst case;
    the latter is None if no limit is on the worst case, or nothing is uncertain.
    """
    problem = transcribed.problem
    if not any(map(is_worst_case, problem.constraints)) or not problem.placements.germs:
        return transcribed, *attempt(transcribed, start, multipliers), None
    oracle = Oracle(problem, factor)
    transcribed = transcribed.at_scenarios(_first(transcribed, oracle, start, known))
    outcome, beside = attempt(transcribed, start, multipliers)
    rounds, worst = 1, np.zeros((0, len(oracle.low)))
    while outcome.status is Status.SOLVED:
        new, worst = _searched(transcribed, oracle, outcome, rounds)
        if not len(new):
            break
        if rounds == _MOST_ROUNDS:
            outcome = replace(outcome, status=Status.WORST_CASE_BROKEN)
            break
        before, idle = outcome, _idle(transcribed, outcome.point)
        assert transcribed.scenarios is not None
        transcribed = transcribed.at_scenarios(transcribed.scenarios.joined(new, idle))
        begun = transcribed.point(transcribed.decisions(before.point))
        outcome, beside = again(transcribed, begun, before.multipliers)
        outcome = outcome.with_effort_of(before)
        rounds += 1
    return transcribed, outcome, beside, _told(transcribed, outcome, oracle, worst, rounds)


def _first(
    transcribed: AbstractTranscribed, oracle: Oracle, start: np.ndarray | None, known: WorstCase | None
) -> Scenarios:
    """The initial scenarios: those of an earlier solution, or those that break each limit most at the start."""
    assert transcribed.scenarios is not None
    box = np.stack([oracle.low, oracle.high], axis=1)
    if known is not None and known.scenarios.shape[1] == len(box):
        return transcribed.scenarios.beginning(np.clip(known.scenarios, *box.T))
    point = transcribed.program.start if start is None else start
    germ = oracle.germ(_candidates(transcribed, oracle, point, 0))
    # Realisations that have no value here may have one elsewhere.
    beyond = np.nan_to_num(oracle(germ, transcribed.decisions(point)).beyond, nan=-np.inf)
    return transcribed.scenarios.beginning(np.unique(germ[np.argmax(beyond, axis=0)], axis=0))


def _candidates(transcribed: AbstractTranscribed, oracle: Oracle, point: np.ndarray, seed: int) -> Points:
    """The initial points of the search: see `candidates`; the collocation points; the present scenarios."""
    assert transcribed.scenarios is not None
    germ = np.concatenate([transcribed.scenarios.held, np.asarray(transcribed.collocation.points)])
    expanded = _expansions(transcribed, point)

    def rank(points: Points) -> np.ndarray:
        matrix = transcribed.basis.matrix(oracle.germ(points))
        worst = [np.argsort(-_largest(np.tensordot(matrix, terms, axes=1)))[:_RANKED] for terms in expanded]
        return np.unique(np.concatenate(worst))

    return np.concatenate([oracle.unit(germ), candidates(germ.shape[1], seed, rank)])


def _largest(values: Float[np.ndarray, "points ..."]) -> Float[np.ndarray, " points"]:
    return np.nan_to_num(values.reshape(len(values), -1), nan=-np.inf).max(axis=1)


def _expansions(transcribed: AbstractTranscribed, point: np.ndarray) -> list[Float[np.ndarray, "terms ..."]]:
    """The coefficients of how far each limit on the worst case is exceeded, at some of its instants."""
    functionals = functionals_of(transcribed.problem.expressions)
    samples = transcribed.at(point).samples
    found = []
    for limit in worst_case_limits(transcribed.problem):
        values = samples[functionals.index(_functional(limit))]
        if limit.is_path:
            values = values[:, :: max(1, values.shape[1] // _RANKED_INSTANTS)]
        side = 1.0 if np.isfinite(float(limit.upper)) else -1.0
        found.append(side * np.asarray(transcribed.collocation.coefficients(jnp.asarray(values))))
    return found


def _functional(limit: Constraint) -> AbstractFunctional:
    (functional,) = functionals_of((limit.expression,))
    return functional


def _searched(
    transcribed: AbstractTranscribed, oracle: Oracle, outcome: Outcome, seed: int
) -> tuple[Float[np.ndarray, "new variables"], Float[np.ndarray, "limits variables"]]:
    """Realisations that break a limit on the worst case by more than the present ones, and the worst of each limit."""
    assert transcribed.scenarios is not None
    decisions = transcribed.decisions(outcome.point)
    points = _candidates(transcribed, oracle, outcome.point, seed)
    beyond = oracle(oracle.germ(points), decisions).beyond
    found = search(lambda places: oracle(oracle.germ(places), decisions).beyond, points, beyond, seed)
    # Present scenarios may exceed a limit between instants too: margins have to enforce it there.
    at_hand = beyond[: len(transcribed.scenarios.held)].max(axis=0)
    allowed = np.maximum(at_hand, 0.0) + HELD / 2 * _sizes(transcribed, outcome)
    new = [
        some[(excess > allowance) & (excess >= _WORTH * excess[0])][:_NEW]
        for some, excess, allowance in zip(*found, allowed, strict=True)
    ]
    worst = np.stack([some[0] for some in found.points])
    return oracle.germ(np.unique(np.concatenate(new), axis=0)), oracle.germ(worst)


def _told(
    transcribed: AbstractTranscribed, outcome: Outcome, oracle: Oracle, worst: np.ndarray, rounds: int
) -> WorstCase:
    """The worst realisations to report: those of the last search, or scenarios that are worse."""
    assert transcribed.scenarios is not None
    germ = np.concatenate([worst, transcribed.scenarios.held])
    decisions = transcribed.decisions(outcome.point)
    reached = oracle(germ, decisions)
    realisations = []
    for i, limit in enumerate(worst_case_limits(transcribed.problem)):
        k = int(np.argmax(np.nan_to_num(reached.beyond[:, i], nan=-np.inf)))
        time = float(reached.time[k, i])
        realisations.append(
            WorstRealisation(
                name=limit.name,
                text=str(limit),
                value=float(reached.value[k, i]),
                beyond=float(reached.beyond[k, i]),
                time=None if np.isnan(time) else time,
                numbers=inputs_at(transcribed.places, germ[k], jnp.asarray(decisions)),
            )
        )
    return WorstCase(tuple(realisations), transcribed.scenarios.found, rounds, oracle.asked)


def _sizes(transcribed: AbstractTranscribed, outcome: Outcome) -> Float[np.ndarray, " limits"]:
    """The magnitudes of the limits on the worst case, to which their violations are relative."""
    pairs = zip(transcribed.problem.constraints, transcribed.rows, strict=True)
    return np.array([outcome.sizes[rows].max() for one, rows in pairs if is_worst_case(one)])


def _idle(transcribed: AbstractTranscribed, point: np.ndarray) -> Bool[np.ndarray, " slots"]:
    """The slots whose realisations are far from all limits on the worst case."""
    assert transcribed.scenarios is not None
    close = np.zeros(len(transcribed.scenarios.used), dtype=bool)
    parts = transcribed.problem.constraints, transcribed.at(point).constraints, transcribed.scales
    for one, values, scale in zip(*parts, strict=True):
        if is_worst_case(one):
            beyond = np.maximum(values - float(one.upper), float(one.lower) - values).reshape(-1, len(close))
            close |= beyond.max(axis=0) > -_IDLE * scale
    return ~close
