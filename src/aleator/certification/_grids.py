"""The error of a problem's own grid, by comparison with a finer one, and the finer grids to solve it on;
likewise what an answer owes to widths of `al.smooth`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import quietly
from aleator.certification._check import (
    NEGLIGIBLE_SPREAD,
    ROUNDING,
    Check,
    begin_check,
    bounded_by,
    row_sizes,
    spread_functionals,
)
from aleator.certification._limits import OWN_ERROR, limits_at, reach_of
from aleator.certification._systems import pieces, simulates_inside
from aleator.design import Problem, functionals_of, instants_of, is_over_time
from aleator.dynamics import Instant
from aleator.nlp import Status
from aleator.solution import COSTLY, TOLERATED, Deviation, GridError, Smoothing, Solution
from aleator.transcription import AbstractTranscribed, excess_of

# A magnitude below this part of its possible size is zero up to integration error.
_NEGLIGIBLE_VALUE = 1e-3
# A spread that stands in the problem counts so many times itself: nobody acts on a hundredth of a standard deviation.
_OF_A_SPREAD = 10.0
# Errors of all intervals together may be so many times the accuracy: most of them die away.
_IN_ALL = 3.0
# Avoids a division of zero by zero.
_TINY = 1e-30
# A grid is far off if it makes a quantity this many times too large.
_FAR_OFF = 10.0
# The finest grid has at most this many times as many steps as the first.
_FINEST = 256
# An error above this part of the last one, with at least twice as many steps, does not converge.
_FALLS = 0.6


def grid_error(check: Check, accuracy: float) -> GridError:
    """The error of a problem's own grid at a point, by comparison with a finer one."""
    transcribed, problem = check.transcribed, check.problem
    resolved, spreads = transcribed.resolve(check.point), spread_functionals(problem)
    deviations = {}
    for one, finer in check.functionals.items():
        own, reach, at = resolved[one.text()], finer.reach, check.own(one)
        mean, std = np.atleast_1d(finer.mean[at]), np.atleast_1d(finer.std[at])
        change = np.maximum(np.abs(np.asarray(own.mean) - mean), np.abs(np.asarray(own.std) - std))
        spread, value, largest = float(np.max(std)), float(np.max(np.abs(mean))), float(np.max(change))
        magnitudes = [
            abs(float(bound)) / factor
            for limit in problem.constraints
            for bounded, factor in bounded_by(limit)
            for bound in (limit.lower, limit.upper)
            if bounded == one and 0 < abs(float(bound)) < np.inf
        ]
        if one in spreads and spread > NEGLIGIBLE_SPREAD * reach:
            magnitudes.append(_OF_A_SPREAD * spread)
        # A quantity that has to be zero, and is, has no magnitude of its own.
        alone = value if value > _NEGLIGIBLE_VALUE * reach else reach
        rounding = max(ROUNDING * reach, check.rounding[one], _TINY)
        size = max(min(magnitudes, default=alone), rounding / accuracy)
        times = instants_of(one, problem.grid, lambda: check.times)
        when = float(times[int(np.argmax(change.reshape(len(times), -1).max(axis=1)))])
        deviations[one.text()] = Deviation(OWN_ERROR * largest, accuracy * size, when, one.order)
    objective, floor = check.meaning.objective, _NEGLIGIBLE_VALUE * reach_of(problem.objective, check)
    away, tolerated = abs(objective - float(check.values[0])), accuracy * max(abs(objective), floor)
    order = min([one.order for one in functionals_of((problem.objective,))], default=Deviation.order)
    limits = limits_at(check)
    # Of limits over time, what is exceeded on the finer grid is exceeded between the instants.
    broken = [one.broken(accuracy) for one in limits if not is_over_time(one.constraint)]
    return GridError(
        steps=problem.grid.steps,
        factor=check.factor,
        integrator=check.integrator,
        accuracy=accuracy,
        objective=Deviation(OWN_ERROR * away, max(tolerated, _TINY), order=order),
        functionals=deviations,
        broken=max(broken, default=(0.0, ""))[1],
        unresolved=max([one.unresolved() for one in limits], default=(0.0, ""))[1] or _drifted(check, accuracy),
        pieces=pieces(problem) or 1,
        by_tolerances=problem.integrator.refined() is not problem.integrator,
        inside=simulates_inside(problem),
    )


def _drifted(check: Check, accuracy: float) -> str:
    """A sentence on errors that add up over a mesh, which no check of single steps sees; empty if they are small."""
    if not check.departed:
        return ""
    drift = float(check.transcribed.meshes_at(check.point)[-1].drifts.sum(axis=1).max())
    if drift <= _IN_ALL * accuracy:
        return ""
    return (
        f"states drift by {drift:.2g} of their magnitude in all, and no simulation confirms an unstable plan: ask for "
        "a smaller error of each interval, al.Simultaneous(error=...)"
    )


def at_half_width(check: Check) -> Smoothing | None:
    """Objective and limits of the same design at half the widths of `al.smooth`: what it owes to smoothing; None
    without widths.
    """
    narrower, transcribed = check.problem.narrower(), check.transcribed
    if narrower is None:
        return None
    again = begin_check(replace(transcribed, problem=narrower), check.point, check.factor, check.systems)()
    sizes, moved, broken = row_sizes(transcribed, check.point), dict[str, float](), dict[str, None]()
    each = zip(narrower.constraints, transcribed.rows, check.values[1:], again.values[1:], strict=True)
    for one, rows, *values in each:
        moved[one.name] = max(moved.get(one.name, 0.0), float(np.max(np.abs(values[1] - values[0]))))
        before, after = (float(np.max(excess_of(one, value))) for value in values)
        if not after <= max(before, 0.0) + TOLERATED * float(np.max(sizes[rows])):
            broken[one.name] = None
    return Smoothing(float(check.values[0]), float(again.values[0]), moved, tuple(broken))


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
    for own, (one, finer) in zip(begun, check.functionals.items(), strict=True):
        true = float(np.sqrt(np.max(finer.mean**2 + finer.std**2)))
        if not (own <= _FAR_OFF * true or own <= check.rounding[one]):
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


def refinement(solutions: Sequence[Solution], *, between: bool) -> Problem | None:
    """The problem on a finer grid that should meet the tolerance, judging by the last solution; None to end.

    - `solutions`: those on the grids so far, the coarsest first;
    - `between`: whether limits that break between the instants, or hold there at a high cost, are the only reason.
    """
    last, problem = solutions[-1], solutions[-1].problem
    error, limits = last.certificate.grid_error, last.certificate.between
    is_enough = limits is None or limits.is_enough
    if error is None or ((between or error.is_met) and is_enough) or last.status is not Status.SOLVED:
        return None
    grid, begun = problem.grid, solutions[0].problem.grid
    if isinstance(grid, Instant) or isinstance(begun, Instant):
        return None
    # Limits may be exceeded between the instants even if the error of the grid is tolerated.
    if error.next_steps > _FINEST * begun.steps or _does_not_help(solutions):
        return None
    return problem.on_grid(grid.divided(error.next_steps), problem.integrator.refined())


def _does_not_help(solutions: Sequence[Solution]) -> bool:
    """Whether finer grids do not lower the error of the grid, or the excess between its instants, over the tolerance.

    A finer grid may lead to another design with another error, so that only two failures in a row count.
    """
    ratios = []
    for one in solutions[-3:]:
        error, between = one.certificate.grid_error, one.certificate.between
        beyond = 0.0 if between is None or between.holds else between.worst / TOLERATED
        cost = between.cost / COSTLY if between else 0.0
        ratios.append(max(np.inf if error is None else error.ratio, beyond, cost))
    return len(ratios) == 3 and min(ratios[1:]) > _FALLS * ratios[0]


def unconverged(solutions: Sequence[Solution]) -> str:
    """Why finer grids do not bring the error down to the tolerance, with the instant; empty if they do."""
    last = solutions[-1]
    error = last.certificate.grid_error
    if len(solutions) == 1 or error is None or error.is_met or last.status is not Status.SOLVED:
        return ""
    paths = [one for one in error.functionals.values() if not np.isnan(one.time)]
    when = f", perhaps near t = {max(paths, key=lambda one: one.ratio).time:.4g} s" if paths else ""
    return (
        f"With up to {error.steps} steps the error does not reach the tolerance: the model seems to jump in "
        f"time{when}. Declare the jump (al.StepFunction), make it smooth, or ask for less accuracy"
    )
