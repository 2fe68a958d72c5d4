"""Limits on the worst case of the model itself, found by a derivative-free search over its realisations, not by its
expansion.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias, final

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
from aleator.ensemble import in_batches, inputs_at
from aleator.nlp import HELD, Outcome
from aleator.solution import WorstCase, WorstRealisation
from aleator.transcription import AbstractTranscribed, Scenarios, germ_box
from aleator.uncertainty import named_numbers

Points: TypeAlias = Float[np.ndarray, "points variables"]
"""Points of the box, scaled to between 0 and 1 in each variable."""

# Points spread over the box in each search, and the most corners that are tried.
_SPREAD, _MOST_CORNERS = 128, 128
# From how many points the search continues for each limit, and their least distance.
_STARTS, _APART = 3, 0.15
# The first and the last step, the number of points in other directions than the axes, and the most axes tried.
_FIRST_STEP, _LAST_STEP, _BESIDE, _MOST_AXES = 0.5, 1e-5, 6, 12
_MOST_SWEEPS = 60
# The most new scenarios per limit and round, and the least excess of a new one, relative to the worst.
_NEW, _WORTH = 2, 0.3
# Slack beyond this part of the scale makes a scenario idle.
_IDLE = 1e-3
# Instants at which the expansion ranks realisations, and how many of these it names.
_RANKED_INSTANTS, _RANKED = 200, 16


def search(
    excess_at: Callable[[Points], np.ndarray], tried: Points, beyond: Float[np.ndarray, "points limits"], seed: int
) -> list[tuple[Points, Float[np.ndarray, " points"]]]:
    """Search from the worst of the points tried to a local worst point near each: for every limit, the worst first, and
    their excess over it.

    It tries points along the axes and in random directions, with steps that shrink if nothing worse is found. It needs
    no derivatives, tolerates kinks, and stops at faces and corners of the box.

    `excess_at`: gives the model's excess over each limit, shape (points, limits), NaN where it has no value.
    """
    generator = np.random.default_rng(seed)
    starts = [_apart(tried, column) for column in np.nan_to_num(beyond, nan=np.inf).T]
    limit, which = np.repeat(np.arange(len(starts)), list(map(len, starts))), np.concatenate(starts)
    at, best = tried[which], np.nan_to_num(beyond[which, limit], nan=np.inf)
    step = np.full(len(at), _FIRST_STEP)

    def values_at(places: np.ndarray, going: np.ndarray) -> np.ndarray:
        """The excess of each start's points over its own limit; infinite where there is no value."""
        excess = excess_at(places.reshape(-1, places.shape[-1])).reshape(*places.shape[:2], -1)
        return np.nan_to_num(np.take_along_axis(excess, limit[going, None, None], axis=2)[..., 0], nan=np.inf)

    for _ in range(_MOST_SWEEPS):
        going = np.flatnonzero((step > _LAST_STEP) & np.isfinite(best))
        if not going.size:
            break
        axes = generator.permutation(at.shape[1])[:_MOST_AXES]
        places = _beside(at[going], step[going], axes, generator)
        values = values_at(places, going)
        leap = _leaps(at[going], step[going], best[going], axes, places, values)[:, None]
        places = np.concatenate([places, leap], axis=1)
        values = np.concatenate([values, values_at(leap, going)], axis=1)
        k = np.argmax(values, axis=1)
        reached, where = values[np.arange(len(going)), k], places[np.arange(len(going)), k]
        better = reached > best[going]
        moved = np.max(np.abs(where - at[going]), axis=1)
        # If the worse point was close, the maximum is presumed near; if it was far, possibly far.
        step[going] = np.where(better, np.clip(2 * moved, step[going] / 8, step[going]), step[going] / 4)
        at[going] = np.where(better[:, None], where, at[going])
        best[going] = np.maximum(best[going], reached)
    order = [np.flatnonzero(limit == i)[np.argsort(-best[limit == i])] for i in range(len(starts))]
    return [(at[one], best[one]) for one in order]


def _apart(points: Points, beyond: Float[np.ndarray, " points"]) -> np.ndarray:
    """The indices of the worst points that are not close to a worse one."""
    chosen: list[int] = []
    for i in np.argsort(-beyond, kind="stable"):
        if all(np.max(np.abs(points[i] - points[j])) >= _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == _STARTS:
            break
    return np.array(chosen)


def _beside(at: Points, step: np.ndarray, axes: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Points near each: one step up and one down along some axes, one after the other, and some in other directions."""
    starts, variables = at.shape
    along = np.kron(np.eye(variables)[axes], [[1.0], [-1.0]])
    if variables > 1:
        others = generator.normal(size=(starts, _BESIDE, variables)) / np.sqrt(variables)
    else:
        others = np.repeat(np.linspace(-0.75, 0.75, _BESIDE)[None, :, None], starts, axis=0)
    moves = np.concatenate([np.repeat(along[None], starts, axis=0), others], axis=1)
    return np.clip(at[:, None] + step[:, None, None] * moves, 0.0, 1.0)


def _leaps(
    at: Points, step: np.ndarray, best: np.ndarray, axes: np.ndarray, places: np.ndarray, values: np.ndarray
) -> Float[np.ndarray, "starts variables"]:
    """Leaps to the vertices of the parabolas along all axes at once; a full step uphill along straight ones."""
    up, down = (np.arange(first, 2 * len(axes), 2) for first in (0, 1))
    a, b = places[:, up, axes] - at[:, axes], at[:, axes] - places[:, down, axes]
    rise, fall = values[:, up] - best[:, None], values[:, down] - best[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        bend, slope = (rise / a + fall / b) / (a + b), (rise * b / a - fall * a / b) / (a + b)
        vertex = np.clip(-slope / (2 * bend), -2 * step[:, None], 2 * step[:, None])
    uphill = np.where(np.maximum(rise, fall) > 0, np.where(rise >= fall, a, -b), 0.0)
    leap = np.where((a > 0) & (b > 0) & (bend < 0), vertex, uphill)
    there = at.copy()
    there[:, axes] += np.where(np.isfinite(rise) & np.isfinite(fall), leap, 0.0)
    return np.clip(there, 0.0, 1.0)


def worst_case_limits(problem: Problem) -> tuple[Constraint, ...]:
    """The limits on the worst case among a problem's constraints."""
    return tuple(one for one in problem.constraints if is_worst_case(one))


class Reached(NamedTuple):
    """Limits on the worst case at some realisations, each where it is closest to its bound or furthest beyond it.

    - `beyond`: the excess over the bound, negative inside; `value`: of the functional; `time`: when (s), NaN if the
      limit is not over time.
    """

    beyond: Float[np.ndarray, "points limits"]
    value: Float[np.ndarray, "points limits"]
    time: Float[np.ndarray, "points limits"]


def _reached(
    problem: Problem, germ: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> tuple[Array, Array, Array]:
    """The parts of `Reached`."""
    limits = worst_case_limits(problem)
    functionals = functionals_of(tuple(one.expression for one in limits))
    times, step = grid_at(problem, decisions).times, step_at(problem, decisions)
    numbers = named_numbers(problem.simulation, decisions)

    def one(values: tuple[Array, ...]) -> tuple[Array, Array, Array]:
        scope = OneSystem(dict(zip(functionals, values, strict=True)), numbers, step)
        reached = []
        for limit in limits:
            value = jnp.asarray(limit.expression.evaluate(scope))
            beyond = jnp.ravel(jnp.maximum(value - limit.upper, limit.lower - value))
            # The first NaN counts as the largest.
            worst = jnp.argmax(beyond)
            own = instants_of(limit, problem.grid, times)
            time = own[worst * len(own) // beyond.size] if limit.is_path and not ends_by_event(problem) else jnp.nan
            reached.append((beyond[worst], jnp.ravel(value)[worst], time))
        return tuple(jnp.stack(part) for part in zip(*reached, strict=True))  # type: ignore[return-value]

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
        return Reached(*in_batches(REACHED, self._traced, germ, jax_array(decisions)))

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
    variables, generator = present.shape[1], np.random.default_rng(seed)
    middle = np.full((1, variables), 0.5)
    ends = middle + np.kron(np.eye(variables), [[-0.5], [0.5]])
    if 2**variables <= _MOST_CORNERS:
        corners = np.indices((2,) * variables).reshape(variables, -1).T.astype(float)
    else:
        corners = generator.integers(0, 2, (_MOST_CORNERS, variables)).astype(float)
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
    beyond = oracle(oracle.germ(points), decisions).beyond
    searched = search(lambda places: oracle(oracle.germ(places), decisions).beyond, points, beyond, seed)
    # The magnitudes of the limits, to which their violations are relative.
    pairs = zip(transcribed.problem.constraints, transcribed.rows, strict=True)
    sizes = np.array([outcome.sizes[rows].max() for one, rows in pairs if is_worst_case(one)])
    # Present scenarios may exceed a limit between instants too: margins have to enforce it there.
    allowed = np.maximum(beyond[: len(transcribed.scenarios.held)].max(axis=0), 0.0) + HELD / 2 * sizes
    new = [
        some[(excess > allowance) & (excess >= _WORTH * excess[0])][:_NEW]
        for (some, excess), allowance in zip(searched, allowed, strict=True)
    ]
    worst = np.stack([some[0] for some, _ in searched])
    return oracle.germ(np.unique(np.concatenate(new), axis=0)), oracle.germ(worst)


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
                numbers=inputs_at(transcribed.places, germ[k], jnp.asarray(decisions)),
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
            beyond = np.maximum(values - float(one.upper), float(one.lower) - values).reshape(-1, len(close))
            close |= beyond.max(axis=0) > -_IDLE * scale
    return ~close
