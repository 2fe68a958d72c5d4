"""Limits on the worst case of the model itself, found by a derivative-free search over its realisations, not by its
expansion.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.design import (
    Constraint,
    OneSystem,
    Problem,
    ends_by_event,
    functionals_of,
    grid_at,
    instants_of,
    is_worst_case,
    responses,
    step_at,
)
from aleator.ensemble import Points, corners_of, in_batches, inputs_at, search
from aleator.nlp import HELD, Outcome
from aleator.solution import WorstCase, WorstRealisation
from aleator.transcription import AbstractTranscribed, Scenarios, excess_of, germ_box
from aleator.uncertainty import named_numbers

# Points spread over the box in each search, and the most corners that are tried.
_SPREAD, _MOST_CORNERS = 128, 128
# The most new scenarios per limit and round, and the least excess of a new one, relative to the worst.
_NEW, _WORTH = 2, 0.3
# Slack beyond this part of the scale makes a scenario idle.
_IDLE = 1e-3
# Instants at which the expansion ranks realisations, and how many of these it names.
_RANKED_INSTANTS, _RANKED = 200, 16


def worst_case_limits(problem: Problem) -> tuple[Constraint, ...]:
    """The limits on the worst case among a problem's constraints."""
    return tuple(one for one in problem.constraints if is_worst_case(one))


class Reached(NamedTuple):
    """Limits on the worst case at some realisations, each where it is closest to its bound or furthest beyond it.

    - `beyond`: the excess over the bound, negative inside; `value`: of the functional; `time`: when (s), NaN if the
      limit is not over time.
    """

    beyond: Float[Any, "points limits"]
    value: Float[Any, "points limits"]
    time: Float[Any, "points limits"]


def _reached(problem: Problem, germ: Float[Array, "points variables"], decisions: Float[Array, " n"]) -> Reached:
    limits = worst_case_limits(problem)
    functionals = functionals_of(tuple(one.expression for one in limits))
    times, step = grid_at(problem, decisions).times, step_at(problem, decisions)
    numbers = named_numbers(problem.simulation, decisions)

    def one(values: tuple[Array, ...]) -> Reached:
        scope, reached = OneSystem(dict(zip(functionals, values, strict=True)), numbers, step), []
        for limit in limits:
            value = jnp.asarray(limit.expression.evaluate(scope))
            beyond = jnp.ravel(jnp.maximum(value - limit.upper, limit.lower - value))
            # The first NaN counts as the largest.
            worst = jnp.argmax(beyond)
            own = instants_of(limit, problem.grid, lambda: times)
            time = own[worst * len(own) // beyond.size] if limit.is_path and not ends_by_event(problem) else jnp.nan
            reached.append((beyond[worst], jnp.ravel(value)[worst], time))
        return Reached(*map(jnp.stack, zip(*reached, strict=True)))

    return jax.vmap(one)(responses(problem, functionals, germ, decisions))


REACHED = Compiled(_reached)


@final
class Oracle:
    """The model of a problem at realisations, in batches, on a grid with `factor` times as many steps as its own.

    `simulated`: the number of realisations so far.
    """

    def __init__(self, problem: Problem, factor: int):
        self._traced = numbers_to_arrays(problem.on_grid(problem.grid.finer(factor)))
        self.low, self.high = germ_box(problem).T
        self.simulated = 0

    def __call__(self, germ: Float[np.ndarray, "points variables"], decisions: np.ndarray) -> Reached:
        self.simulated += len(germ)
        return in_batches(REACHED, self._traced, germ, jax_array(decisions))

    def germ(self, points: Points) -> Float[np.ndarray, "points variables"]:
        """Map points of the unit box into the germ's box."""
        return self.low + points * (self.high - self.low)

    def unit(self, germ: Float[np.ndarray, "points variables"]) -> Points:
        """The inverse of `germ`."""
        return (germ - self.low) / (self.high - self.low)


def scenarios_at_start(
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
    """Initial points of the search: present scenarios, collocation points, the middle, ends of each variable, corners,
    some points inside, and those of many more that the expansions call the worst.
    """
    assert transcribed.scenarios is not None
    present = oracle.unit(np.concatenate([transcribed.scenarios.held, np.asarray(transcribed.collocation.points)]))
    present = np.clip(present, 0.0, 1.0)  # a tolerance ends where its normal distribution goes on
    variables, generator = present.shape[1], np.random.default_rng(seed)
    middle = np.full((1, variables), 0.5)
    ends = middle + np.kron(np.eye(variables), [[-0.5], [0.5]])
    corners = corners_of(variables, _MOST_CORNERS, generator)
    inside = scipy.stats.qmc.Sobol(variables, rng=generator).random(16 * _SPREAD)
    many = np.concatenate([inside, np.round(inside), np.round(generator.random(inside.shape))])
    matrix, ranked = transcribed.basis.matrix(oracle.germ(many)), []
    functionals, samples = functionals_of(transcribed.problem.expressions), transcribed.at(point).samples
    for limit in worst_case_limits(transcribed.problem):
        (functional,) = functionals_of((limit.expression,))
        values = samples[functionals.index(functional)]
        if limit.is_path:
            values = values[:, :: max(1, values.shape[1] // _RANKED_INSTANTS)]
        side = 1.0 if np.isfinite(float(limit.upper)) else -1.0
        terms = side * np.asarray(transcribed.collocation.coefficients(jax_array(values)))
        largest = np.tensordot(matrix, terms, axes=1).reshape(len(many), -1).max(axis=1)
        ranked.append(np.argsort(-np.nan_to_num(largest, nan=-np.inf))[:_RANKED])
    worst = np.unique(np.concatenate(ranked))
    return np.concatenate([present, middle, ends, corners, inside[:_SPREAD], many[worst]])


def broken_at(
    transcribed: AbstractTranscribed, oracle: Oracle, outcome: Outcome, seed: int
) -> tuple[Float[np.ndarray, "new variables"], Float[np.ndarray, "limits variables"]]:
    """Realisations that break a limit on the worst case by more than the present ones, and the worst of each limit."""
    assert transcribed.scenarios is not None
    decisions = transcribed.decisions(outcome.point)
    points = _candidates(transcribed, oracle, outcome.point, seed)
    # The magnitudes of the limits, to which their violations are relative.
    pairs = zip(transcribed.problem.constraints, transcribed.rows, strict=True)
    sizes = np.array([outcome.sizes[rows].max() for one, rows in pairs if is_worst_case(one)])
    imposed = np.ones((len(transcribed.scenarios.held), len(sizes)), dtype=bool)
    new, worst = worth_imposing(
        lambda places: oracle(oracle.germ(places), decisions).beyond, points, imposed, sizes, seed
    )
    return oracle.germ(np.unique(np.concatenate(new), axis=0)), oracle.germ(worst)


def worth_imposing(
    excess_at: Callable[[Points], Float[np.ndarray, "points limits"]],
    candidates: Points,
    imposed: Bool[np.ndarray, "scenarios limits"],
    sizes: Float[np.ndarray, " limits"],
    seed: int,
) -> tuple[list[Points], Points]:
    """The few points of the unit box at which each limit is exceeded by more than at present, and not by far less than
    at the worst; and the worst point of each limit.

    - `candidates`: where a search begins, the present scenarios first; `imposed`: which limits hold at these;
    - `sizes`: the magnitudes of the limits.
    """
    beyond = excess_at(candidates)
    # Present scenarios may exceed a limit between instants too: margins have to enforce it there.
    held = np.where(imposed, beyond[: len(imposed)], -np.inf).max(axis=0)
    allowed = np.fmax(held, 0.0) + HELD / 2 * sizes  # NaN is worse than anything
    new, worst = [], []
    for (some, excess), allowance in zip(search(excess_at, candidates, beyond, seed), allowed, strict=True):
        new.append(some[(excess > allowance) & (excess >= _WORTH * excess[0])][:_NEW])
        worst.append(some[0])
    return new, np.stack(worst)


def worst_case_of(
    transcribed: AbstractTranscribed,
    outcome: Outcome,
    oracle: Oracle,
    worst: np.ndarray,
    rounds: int,
    is_found: bool,
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
                numbers=inputs_at(transcribed.places, germ[k], jax_array(decisions)),
            )
        )
    return WorstCase(tuple(realisations), transcribed.scenarios.found, rounds, oracle.simulated, is_found)


def idle_scenarios(transcribed: AbstractTranscribed, point: np.ndarray) -> Bool[np.ndarray, " slots"]:
    """The slots whose realisations are far from all limits on the worst case."""
    assert transcribed.scenarios is not None
    close = np.zeros(len(transcribed.scenarios.used), dtype=bool)
    parts = transcribed.problem.constraints, transcribed.at(point).constraints, transcribed.scales
    for one, values, scale in zip(*parts, strict=True):
        if is_worst_case(one):
            close |= excess_of(one, values).reshape(-1, len(close)).max(axis=0) > -_IDLE * scale
    return ~close
