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
        self.limits = worst_case_limits(problem)
        self.low, self.high = germ_box(problem).T
        self.simulated = 0

    def __call__(self, germ: Float[np.ndarray, "points variables"], decisions: np.ndarray) -> Reached:
        self.simulated += len(germ)
        return in_batches(REACHED, self._traced, germ, jax_array(decisions))

    def germ(self, points: Points) -> Float[np.ndarray, "points variables"]:
        """Map points of the unit box into the germ's box."""
        return self.low + points * (self.high - self.low)

    def begun(
        self, transcribed: AbstractTranscribed, start: np.ndarray, known: WorstCase | None
    ) -> AbstractTranscribed:
        """The program with its initial scenarios: those of an earlier solution, or those that break each limit most at
        the start.
        """
        if known is not None and known.scenarios.shape[1] == len(self.low):
            return transcribed.at_scenarios(_held(transcribed).beginning(np.clip(known.scenarios, self.low, self.high)))
        germ = self.germ(self._candidates(transcribed, start, 0))
        # Realisations that have no value here may have one elsewhere.
        beyond = np.nan_to_num(self(germ, transcribed.decisions(start)).beyond, nan=-np.inf)
        worst = np.unique(germ[np.argmax(beyond, axis=0)], axis=0)
        return transcribed.at_scenarios(_held(transcribed).beginning(worst))

    def _candidates(self, transcribed: AbstractTranscribed, point: np.ndarray, seed: int) -> Points:
        """Initial points of the search: present scenarios, collocation points, the middle, ends of each variable,
        corners, some points inside, and those of many more that the expansions call the worst.
        """
        germ = np.concatenate([_held(transcribed).held, np.asarray(transcribed.collocation.points)])
        # A tolerance ends where its normal distribution goes on.
        present = np.clip((germ - self.low) / (self.high - self.low), 0.0, 1.0)
        variables, generator = present.shape[1], np.random.default_rng(seed)
        middle = np.full((1, variables), 0.5)
        ends = middle + np.kron(np.eye(variables), [[-0.5], [0.5]])
        corners = corners_of(variables, _MOST_CORNERS, generator)
        inside = scipy.stats.qmc.Sobol(variables, rng=generator).random(16 * _SPREAD)
        many = np.concatenate([inside, np.round(inside), np.round(generator.random(inside.shape))])
        matrix, ranked = transcribed.basis.matrix(self.germ(many)), []
        functionals, samples = functionals_of(transcribed.problem.expressions), transcribed.at(point).samples
        for limit in self.limits:
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

    def broken(
        self, transcribed: AbstractTranscribed, outcome: Outcome, seed: int
    ) -> tuple[Float[np.ndarray, "new variables"], Float[np.ndarray, "limits variables"]]:
        """Realisations that break a limit by more than the present ones, and the worst of each limit."""
        decisions, points = transcribed.decisions(outcome.point), self._candidates(transcribed, outcome.point, seed)
        # The magnitudes of the limits, to which their violations are relative.
        pairs = zip(transcribed.problem.constraints, transcribed.rows, strict=True)
        sizes = np.array([outcome.sizes[rows].max() for one, rows in pairs if is_worst_case(one)])
        imposed = np.ones((len(_held(transcribed).held), len(sizes)), dtype=bool)
        new, worst = worth_imposing(lambda one: self(self.germ(one), decisions).beyond, points, imposed, sizes, seed)
        return self.germ(np.unique(np.concatenate(new), axis=0)), self.germ(worst)

    def imposed(
        self, transcribed: AbstractTranscribed, outcome: Outcome, new: Float[np.ndarray, "new variables"]
    ) -> AbstractTranscribed:
        """The program with new scenarios, in the place of those that are far from all limits."""
        scenarios = _held(transcribed)
        close = np.zeros(len(scenarios.used), dtype=bool)
        parts = transcribed.problem.constraints, transcribed.at(outcome.point).constraints, transcribed.scales
        for one, values, scale in zip(*parts, strict=True):
            if is_worst_case(one):
                close |= excess_of(one, values).reshape(-1, len(close)).max(axis=0) > -_IDLE * scale
        return transcribed.at_scenarios(scenarios.joined(new, ~close))

    def found(
        self, transcribed: AbstractTranscribed, outcome: Outcome, worst: np.ndarray, rounds: int, *, is_found: bool
    ) -> WorstCase:
        """The worst realisations to report: those of the last search, or scenarios that are worse."""
        scenarios, decisions = _held(transcribed), transcribed.decisions(outcome.point)
        germ = np.concatenate([worst, scenarios.held])
        reached, realisations = self(germ, decisions), []
        for i, limit in enumerate(self.limits):
            k = int(np.argmax(np.nan_to_num(reached.beyond[:, i], nan=-np.inf)))
            value, beyond, time = (float(of[k, i]) for of in (reached.value, reached.beyond, reached.time))
            numbers = inputs_at(transcribed.places, germ[k], jax_array(decisions))
            when = None if np.isnan(time) else time
            realisations.append(WorstRealisation(limit.name, str(limit), value, beyond, when, numbers))
        return WorstCase(tuple(realisations), scenarios.found, rounds, self.simulated, is_found)


def _held(transcribed: AbstractTranscribed) -> Scenarios:
    """The scenarios of a program that has limits on the worst case."""
    assert transcribed.scenarios is not None
    return transcribed.scenarios


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
