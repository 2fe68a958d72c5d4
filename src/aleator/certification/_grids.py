"""The error of a problem's own grid, by comparison with a finer one, and the finer grids to solve it on."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import quietly
from aleator.certification._check import (
    NEGLIGIBLE_SPREAD,
    ROUNDING,
    Check,
    begin_check,
    bounded_by,
    pieces,
    rounding_at,
    row_sizes,
    simulates_inside,
    spread_functionals,
)
from aleator.design import Constraint, Expression, Peak, Problem, Statistic, functionals_of, history, is_over_time
from aleator.dynamics import Grid
from aleator.nlp import Status
from aleator.solution import TOLERATED, Deviation, GridError, Solution
from aleator.statistics import Std, Variance
from aleator.transcription import AbstractTranscribed, Meaning, bound_size

# A magnitude below this part of its possible size is zero up to integration error.
_NEGLIGIBLE_VALUE = 1e-3
# A spread that stands in the problem counts so many times itself: nobody acts on a hundredth of a standard deviation.
_OF_A_SPREAD = 10.0
# Allowance for the error of the finer grid itself, which is much smaller.
_OWN_ERROR = 1.25
# Avoids a division of zero by zero.
_TINY = 1e-30
# An excess on a finer grid is an error of the grid if the grids differ by at least this part of it.
_OF_THE_GRID = 0.1
# A grid that differs from a finer one by more than these parts of a limit's size does not tell whether it holds: by
# the first if it is no further from its bound than that, by the second wherever it is.
_NEAR_BOUND, _ANYWHERE = 0.05, 0.25
# A grid is far off if it makes a quantity this many times too large.
_FAR_OFF = 10.0
# The finest grid has at most this many times as many steps as the first.
_FINEST = 256
# An error above this part of the last one, with at least twice as many steps, does not converge.
_FALLS = 0.6


def grid_error(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    finer: Check,
    accuracy: float,
) -> GridError:
    """The error of a problem's own grid at a point, by comparison with a finer one."""
    problem, resolved = transcribed.problem, transcribed.resolve(point)
    meaning = transcribed.at(point)
    times = meaning.times
    functionals = functionals_of(problem.expressions)
    reaches = dict(zip(functionals, finer.reaches, strict=True))
    rounding, spreads = rounding_at(transcribed, point, finer.reaches), spread_functionals(problem)
    deviations = {}
    for i, one in enumerate(functionals):
        own = resolved[one.text()]
        mean, std = (np.asarray(part)[:: finer.factor if one.is_path else 1] for part in _at_least_1d(finer, i))
        change = np.maximum(np.abs(np.asarray(own.mean) - mean), np.abs(np.asarray(own.std) - std))
        limits = _limits(problem, one)
        spread, value, reach = float(np.max(std)), float(np.max(np.abs(mean))), reaches[one]
        is_spread = one in spreads and spread > NEGLIGIBLE_SPREAD * reach
        magnitudes = [*limits, *([_OF_A_SPREAD * spread] if is_spread else [])]
        # A quantity that has to be zero, and is, has no magnitude of its own.
        alone = value if value > _NEGLIGIBLE_VALUE * reach else reach
        size = max(min(magnitudes, default=alone), max(ROUNDING * reach, rounding[one], _TINY) / accuracy)
        when = float(times[int(np.argmax(change.reshape(len(times), -1).max(axis=1)))]) if one.is_path else np.nan
        largest = float(np.max(change))
        deviations[one.text()] = Deviation(_OWN_ERROR * largest, accuracy * size, when, one.order)
    objective = meaning.objective
    away = _OWN_ERROR * abs(objective - float(finer.values[0]))
    floor = _NEGLIGIBLE_VALUE * reach_of(problem.objective, reaches)
    sizes = limit_sizes(transcribed, point, reaches)
    return GridError(
        steps=problem.grid.steps,
        factor=finer.factor,
        integrator=finer.integrator,
        accuracy=accuracy,
        objective=Deviation(away, max(accuracy * max(abs(objective), floor), _TINY), order=_order(problem.objective)),
        functionals=deviations,
        broken=broken(transcribed, meaning.constraints, finer, sizes, accuracy),
        unresolved=unresolved(transcribed, meaning, finer, sizes),
        pieces=pieces(problem) or 1,
        by_tolerances=problem.integrator.refined() is not problem.integrator,
        inside=simulates_inside(problem),
    )


def misled_at(
    transcribed: AbstractTranscribed,
    start: Float[np.ndarray, " variables"],
    begun: list[float],
    end: Float[np.ndarray, " variables"] | None,
    factor: int,
) -> str:
    """A sentence on a functional for which the grid is far off at the start of a search; empty if there is none.

    A step that is too long for a design makes it appear unstable. The search may then avoid it for a design at rest,
    where the grid appears exact. So the start is checked where some functional is far larger there than at the `end`,
    or the search has failed (None).

    - `begun`: the magnitudes at the start, see `magnitudes_at`.
    """
    problem = transcribed.problem
    if end is not None and all(
        own <= _FAR_OFF * later for own, later in zip(begun, magnitudes_at(transcribed, end), strict=True)
    ):
        return ""
    check = begin_check(transcribed, start, factor)()
    rounding = rounding_at(transcribed, start, check.reaches)
    for one, own, mean, std in zip(functionals_of(problem.expressions), begun, check.means, check.stds, strict=True):
        true = float(np.sqrt(np.max(mean**2 + std**2)))
        if not (own <= _FAR_OFF * true or own <= rounding[one]):
            return (
                f"at the start of the search {problem.grid.steps} steps give {one.text()} as {own:.3g}, where "
                f"{true:.3g} is right: the search may have avoided good designs"
            )
    return ""


@quietly
def magnitudes_at(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]) -> list[float]:
    """The largest root mean square of each functional over the collocation points."""
    weights = np.abs(np.asarray(transcribed.collocation.weights))
    each = (np.asarray(samples).reshape(len(weights), -1) for samples in transcribed.at(point).samples)
    return [float(np.sqrt(np.max(weights @ samples**2))) for samples in each]


def _order(objective: Expression) -> int:
    """The order of convergence of the objective: the lowest among its parts."""
    return min([one.order for one in functionals_of((objective,))], default=Deviation.order)


def _at_least_1d(finer: Check, which: int) -> tuple[np.ndarray, np.ndarray]:
    return np.atleast_1d(finer.means[which]), np.atleast_1d(finer.stds[which])


def _limits(problem: Problem, functional: Any) -> list[float]:
    """The bounds other than zero that a functional is held to, in its own unit."""
    limits = []
    for one in problem.constraints:
        sizes = [abs(float(bound)) for bound in (one.lower, one.upper)]
        for bounded, factor in bounded_by(one):
            limits += [size / factor for size in sizes if bounded == functional and 0 < size < np.inf]
    return limits


class _Difference(NamedTuple):
    """By how much a limit's values differ from those of other grids, and how far they are from a bound there.

    `time`: when, in s; NaN for a limit that has no time.
    """

    away: float
    slack: float
    time: float


def broken(
    transcribed: AbstractTranscribed,
    own: list[Float[np.ndarray, " rows"]],
    finer: Check,
    sizes: list[float],
    accuracy: float,
) -> str:
    """A sentence on the constraint, no limit over time, that is broken most on the finer grid; empty if all hold.

    A difference that is equal on both grids is no error of the grid, however small its tolerance.
    """
    problem = transcribed.problem
    worst, sentence = accuracy, ""
    for one, size, before, value in zip(problem.constraints, sizes, own, finer.values[1:], strict=True):
        if is_over_time(one):
            continue
        if not np.isfinite(value).all():
            return f"on a finer grid '{one.name}' ({one}) is not a number"
        excess = float(np.max(np.maximum(value - float(one.upper), float(one.lower) - value)))
        changed = float(np.max(np.abs(np.ravel(value) - before)))
        if excess > worst * size > 0 and changed > _OF_THE_GRID * excess:
            worst = excess / size
            sentence = f"on a finer grid '{one.name}' ({one}) exceeds its bound by {excess:.2g}"
    return sentence


def unresolved(transcribed: AbstractTranscribed, meaning: Meaning, finer: Check, sizes: list[float]) -> str:
    """A sentence on the limit that differs most from a finer grid, so much that nothing is known of whether it holds,
    on whichever side of its bound it is there; empty if there is none.

    `meaning`: of the point on the problem's own grid; `sizes`: see `limit_sizes`.
    """
    worst, sentence = 0.0, ""
    for i, (one, size) in enumerate(zip(transcribed.problem.constraints, sizes, strict=True)):
        if not size > 0:
            continue
        own, value = np.ravel(meaning.constraints[i]), np.asarray(finer.values[1 + i])
        magnitude = max(size, float(np.abs(own).max()), float(np.abs(value).max()))
        for difference in _differences(one, own, value, finer.factor, meaning.times):
            is_near = difference.away > _NEAR_BOUND * size and difference.away > abs(difference.slack)
            if (is_near or difference.away > _ANYWHERE * magnitude) and difference.away > worst * size:
                worst = difference.away / size
                when = "" if np.isnan(difference.time) else f" at t = {difference.time:.4g} s"
                sentence = (
                    f"'{one.name}' ({one}) differs by {difference.away:.2g}{when} on a finer grid, so that these steps "
                    "do not tell whether it holds"
                )
    return sentence


def _differences(
    one: Constraint, own: np.ndarray, value: np.ndarray, factor: int, times: Float[np.ndarray, " instants"]
) -> Iterator[_Difference]:
    """The differences between a limit's values on its own grid, shape (rows,), and on the finer one."""
    if one.is_path:
        yield from _on_paths(one, own, value, factor, times)
        return
    changed = np.abs(np.ravel(value) - own)
    slacks = np.minimum(float(one.upper) - np.ravel(value), np.ravel(value) - float(one.lower))
    k = int(np.argmax(changed))
    # What a peak exceeds between the instants is held there by margins.
    is_peak = any(isinstance(part, Peak) for part in functionals_of((one.expression,)))
    yield _Difference(_OWN_ERROR * float(changed[k]), np.inf if is_peak else float(slacks[k]), np.nan)


def _on_paths(
    one: Constraint, own: np.ndarray, value: np.ndarray, factor: int, times: Float[np.ndarray, " instants"]
) -> Iterator[_Difference]:
    """How far a path at the instants is outside what it reaches on the finer grid within a step of them.

    So a jump that lies on the other side of an instant there makes no difference.
    """
    rows, fine = own.reshape(len(times), -1), value.reshape(len(value), -1)
    windows = np.arange(len(times))[:, None] * factor + np.arange(-factor, factor + 1)[None, :]
    around = fine[np.clip(windows, 0, len(fine) - 1)]
    away = _OWN_ERROR * np.maximum(rows - around.max(axis=1), around.min(axis=1) - rows)
    there = fine[::factor]
    slacks = np.minimum(float(one.upper) - there, there - float(one.lower))
    for worst in (away, np.where(away > np.abs(slacks), away, -np.inf)):
        i, entry = np.unravel_index(int(np.argmax(worst)), worst.shape)
        if away[i, entry] > 0:
            yield _Difference(float(away[i, entry]), float(slacks[i, entry]), float(times[i]))


def limit_sizes(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], reaches: dict[Any, float]
) -> list[float]:
    """The size of each limit: its smaller bound or, where that is zero, how large its expression may be.

    `reaches`: how large each functional could be.
    """
    rows = row_sizes(transcribed, point)
    return [
        bound_size(one) or max(reach_of(one.expression, reaches), float(np.max(rows[own])))
        for one, own in zip(transcribed.problem.constraints, transcribed.rows, strict=True)
    ]


def reach_of(expression: Expression, reaches: dict[Any, float]) -> float:
    """The possible size of an expression, from that of its functionals; zero if unknown."""
    return sum(
        abs(float(factor)) * sum(_reach(part, reaches) for part in atom.parts)
        for factor, atom in zip(expression.factors, expression.atoms, strict=True)
    )


def _reach(atom: Any, reaches: dict[Any, float]) -> float:
    """The possible size of a statistic; a spread is no larger than the functional itself."""
    if not isinstance(atom, Statistic):
        return 0.0
    reach = reaches[atom.functionals[0]]
    if isinstance(atom.kind, Variance):
        return reach**2
    return reach if atom.kind.speaks_of_one_system or isinstance(atom.kind, Std) else 0.0


def refinement(solutions: Sequence[Solution]) -> Problem | None:
    """The problem on a finer grid that should meet the tolerance, judging by the last solution; None to end.

    `solutions`: those on the grids so far, the coarsest first.
    """
    last, problem = solutions[-1], solutions[-1].problem
    error = last.certificate.grid_error
    between = last.certificate.between
    is_enough = between is None or (between.worst <= TOLERATED and not between.is_costly)
    if error is None or (error.is_met and is_enough) or last.status is not Status.SOLVED:
        return None
    grid, begun = problem.grid, solutions[0].problem.grid
    if not (isinstance(grid, Grid) and isinstance(begun, Grid)):
        return None
    # Limits may be exceeded between the instants even if the error of the grid is tolerated.
    steps = error.with_whole_pieces(2 * grid.steps) if error.is_met else error.steps_needed
    if steps > _FINEST * begun.steps or _does_not_help(solutions):
        return None
    return problem.on_grid(grid.divided(steps), problem.integrator.refined())


def _does_not_help(solutions: Sequence[Solution]) -> bool:
    """Whether finer grids do not lower the error.

    A finer grid may lead to another design with another error, so that only two failures in a row count.
    """
    ratios = [_ratio(one) for one in solutions[-3:]]
    return len(ratios) == 3 and min(ratios[1:]) > _FALLS * ratios[0]


def _ratio(solution: Solution) -> float:
    """The error of the grid, or the excess between its instants, over the tolerance."""
    error, between = solution.certificate.grid_error, solution.certificate.between
    if error is None:
        return np.inf
    beyond = between.worst / TOLERATED if between and between.worst > TOLERATED else 0.0
    return max(error.ratio, beyond, between.cost_ratio if between else 0.0)


def unconverged(solutions: Sequence[Solution]) -> str:
    """Why finer grids do not bring the error down to the tolerance, with the instant; empty if they do."""
    last = solutions[-1]
    error = last.certificate.grid_error
    if len(solutions) == 1 or error is None or error.is_met or last.status is not Status.SOLVED:
        return ""
    return (
        f"With up to {error.steps} steps the "
        f"error does not reach the tolerance: the model seems to jump in time, near t = {_when(last):.4g} s. Put the "
        "jump on an instant of the grid, make it smooth, or ask for less accuracy"
    )


def _when(solution: Solution) -> float:
    """The instant from which twice as many steps give another result, with uncertain numbers at their means."""
    problem = solution.problem
    grid = problem.grid
    assert isinstance(grid, Grid)
    finer = problem.on_grid(grid.finer(2))
    germ, decisions = jnp.zeros(len(problem.placements.germ_names)), jnp.asarray(solution.vector)
    coarse, fine = (jax.jit(lambda x, one=one: history(one, germ, x))(decisions) for one in (problem, finer))
    changes = np.zeros(grid.steps)
    for name in dict.fromkeys(name for one in functionals_of(problem.expressions) for name in one.outputs):
        one, other = (np.asarray(values).reshape(len(values), -1) for values in (coarse[name], fine[name][::2]))
        away = np.abs(one - other).max(axis=1) / max(float(np.abs(other).max()), np.finfo(float).tiny)
        changes = np.maximum(changes, np.abs(np.diff(away)))
    return float(solution.instants[int(np.argmax(changes))])
