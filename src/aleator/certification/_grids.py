"""The error of a problem's own grid, by comparison with a finer one, and the finer grids to solve it on;
likewise what an answer owes to widths of `al.smooth`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import quietly
from aleator.certification._check import (
    NEGLIGIBLE_SPREAD,
    ROUNDING,
    Check,
    Limit,
    begin_check,
    bounded_by,
    row_sizes,
)
from aleator.certification._systems import pieces, simulates_inside
from aleator.design import AbstractFunctional, Peak, Problem, functionals_of, instants_of, is_over_time
from aleator.dynamics import Instant
from aleator.nlp import Status
from aleator.solution import COSTLY, TOLERATED, Deviation, GridError, Smoothing, Solution
from aleator.transcription import AbstractTranscribed, excess_of

OWN_ERROR = 1.25
"""Allowance for the error of the finer grid itself, which is much smaller."""

# An excess on a finer grid is an error of the grid if the grids differ by at least this part of it.
_OF_THE_GRID = 0.1
# A grid that differs from a finer one by more than these parts of a limit's size does not tell whether it holds: by
# the first if it is no further from its bound than that, by the second wherever it is.
_NEAR_BOUND, _ANYWHERE = 0.05, 0.25
# A magnitude below this part of its possible size is zero up to integration error.
_NEGLIGIBLE_VALUE = 1e-3
# A spread that stands in the problem counts so many times itself: nobody acts on a hundredth of a standard deviation.
_OF_A_SPREAD = 10.0
# Errors of all intervals together may be so many times the accuracy: most of them die away.
_IN_ALL = 3.0
# Avoids a division of zero by zero.
_TINY = 1e-30
# An objective that becomes zero, as a squared distance from a target does, counts as zero below this part of its gain.
_OF_THE_GAIN = 1e-9
# A grid is far off if it makes a quantity this many times too large.
_FAR_OFF = 10.0
# The finest grid has at most this many times as many steps as the first.
_FINEST = 256
# An error above this part of the last one, with at least twice as many steps, does not converge.
_FALLS = 0.6


def grid_error(check: Check, accuracy: float) -> GridError:
    """The error of a problem's own grid at a point, by comparison with a finer one."""
    problem, objective = check.problem, check.meaning.objective
    deviations = {one.text(): _deviation(check, one, accuracy) for one in check.functionals}
    away, floor = abs(objective - float(check.values[0])), _NEGLIGIBLE_VALUE * check.reach_of(problem.objective)
    order = min([one.order for one in functionals_of((problem.objective,))], default=Deviation.order)
    tolerated = max(accuracy * max(abs(objective), floor), _TINY)
    if OWN_ERROR * away > tolerated:
        tolerated = max(tolerated, _OF_THE_GAIN * check.gained)
    broken = max((_broken(one, accuracy) for one in check.limits), default=(0.0, ""))[1]
    return GridError(
        steps=problem.grid.steps,
        factor=check.factor,
        objective=Deviation(OWN_ERROR * away, tolerated, order=order),
        functionals=deviations,
        broken=broken or max(map(_unresolved, check.limits), default=(0.0, ""))[1] or _drifted(check, accuracy),
        pieces=pieces(problem) or 1,
        by_tolerances=problem.integrator.refined() is not problem.integrator,
        inside=simulates_inside(problem),
    )


def _deviation(check: Check, one: AbstractFunctional, accuracy: float) -> Deviation:
    """How far a functional is off on the problem's own grid, as a part of its bounds or of a spread that matters."""
    own, finer, at = check.transcribed.resolve(check.point)[one.text()], check.functionals[one], check.own(one)
    mean, std = np.atleast_1d(finer.mean[at]), np.atleast_1d(finer.std[at])
    change = np.maximum(np.abs(np.asarray(own.mean) - mean), np.abs(np.asarray(own.std) - std))
    spread, value = float(np.max(std)), float(np.max(np.abs(mean)))
    magnitudes = [
        abs(float(bound)) / factor
        for limit in check.problem.constraints
        for bounded, factor in bounded_by(limit)
        for bound in (limit.lower, limit.upper)
        if bounded == one and 0 < abs(float(bound)) < np.inf
    ]
    if finer.is_spread and spread > NEGLIGIBLE_SPREAD * finer.reach:
        magnitudes.append(_OF_A_SPREAD * spread)
    # A quantity that has to be zero, and is, has no magnitude of its own.
    alone = value if value > _NEGLIGIBLE_VALUE * finer.reach else finer.reach
    rounding = max(ROUNDING * finer.reach, finer.rounding, _TINY)
    size = max(min(magnitudes, default=alone), rounding / accuracy)
    times = instants_of(one, check.problem.grid, lambda: check.times)
    when = float(times[int(np.argmax(change.reshape(len(times), -1).max(axis=1)))])
    return Deviation(OWN_ERROR * float(np.max(change)), accuracy * size, when, one.order)


def _broken(limit: Limit, accuracy: float) -> tuple[float, str]:
    """The excess of a limit on the finer grid over its size, and a sentence on it; zero and empty if it holds there.

    Of limits over time, what is exceeded on the finer grid is exceeded between the instants. A difference that is equal
    on both grids is no error of the grid, however small its tolerance.
    """
    if is_over_time(limit.constraint):
        return 0.0, ""
    if not np.isfinite(limit.fine).all():
        return np.inf, f"on a finer grid {limit} is not a number"
    excess, changed = float(limit.beyond.max()), float(np.abs(limit.fine - limit.own).max())
    if not (excess > accuracy * limit.size > 0 and changed > _OF_THE_GRID * excess):
        return 0.0, ""
    return excess / limit.size, f"on a finer grid {limit} exceeds its bound by {excess:.2g}"


def _unresolved(limit: Limit) -> tuple[float, str]:
    """The largest difference from the finer grid, over the size, that leaves open on which side of its bound a limit is
    there, and a sentence on it; zero and empty if there is none.
    """
    if not limit.size > 0:
        return 0.0, ""
    away, slack = OWN_ERROR * limit.away, np.abs(limit.beyond[:: limit.factor])
    if any(isinstance(part, Peak) for part in functionals_of((limit.constraint.expression,))):
        slack = np.inf  # what a peak exceeds between the instants is held there by margins
    magnitude = max(limit.size, float(np.abs(limit.own).max()), float(np.abs(limit.fine).max()))
    is_near = (away > _NEAR_BOUND * limit.size) & (away > slack)
    doubtful = np.where(is_near | (away > _ANYWHERE * magnitude), away, 0.0)
    row, entry = np.unravel_index(int(np.argmax(doubtful)), doubtful.shape)
    by, when = float(doubtful[row, entry]), "" if np.isnan(limit.times[row]) else f" at t = {limit.times[row]:.4g} s"
    said = f"{limit} differs by {by:.2g}{when} on a finer grid, so that these steps do not tell whether it holds"
    return (by / limit.size, said) if by > 0 else (0.0, "")


def _drifted(check: Check, accuracy: float) -> str:
    """A sentence on errors that add up over a mesh, which no check of single steps sees; empty if they are small."""
    if not check.simulations.departed:
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


class Start(NamedTuple):
    """Where a search began, and the largest root mean square of each functional there."""

    point: Float[np.ndarray, " variables"]
    magnitudes: list[float]

    @classmethod
    @quietly
    def of(cls, transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]) -> Self:
        samples = map(np.asarray, transcribed.at(point).samples)
        return cls(point, [float(np.sqrt(np.max(np.mean(one**2, axis=0)))) for one in samples])


def misled_at(
    transcribed: AbstractTranscribed,
    start: Start,
    end: Float[np.ndarray, " variables"] | None,
    factor: int,
) -> str:
    """A sentence on a functional for which the grid is far off at the start of a search; empty if there is none.

    A step that is too long for a design makes it appear unstable. The search may then avoid it for a design at rest,
    where the grid appears exact. So the start is checked where some functional is far larger there than at the `end`,
    or the search has failed (None).
    """
    steps, ended = transcribed.problem.grid.steps, [] if end is None else Start.of(transcribed, end).magnitudes
    if ended and all(own <= _FAR_OFF * later for own, later in zip(start.magnitudes, ended, strict=True)):
        return ""
    check = begin_check(transcribed, start.point, factor)()
    for own, (one, finer) in zip(start.magnitudes, check.functionals.items(), strict=True):
        true = float(np.sqrt(np.max(finer.mean**2 + finer.std**2)))
        if not (own <= _FAR_OFF * true or own <= finer.rounding):
            return (
                f"at the start of the search {steps} steps give {one.text()} as {own:.3g}, where {true:.3g} is right: "
                "the search may have avoided good designs. Use more steps"
            )
    return ""


def refinement(solutions: Sequence[Solution], *, between: bool) -> Problem | None:
    """The problem on a finer grid that should meet the tolerance, judging by the last solution; None to end.

    - `solutions`: those on the grids so far, the coarsest first;
    - `between`: whether limits that break between the instants, or hold there at a high cost, are the only reason.

    A finer grid may lead to another design with another error, so that only two failures in a row to lower it end this.
    """
    last, problem, ratios = solutions[-1], solutions[-1].problem, []
    error, limits = last.certificate.grid_error, last.certificate.between
    # Limits may be exceeded between the instants even if the error of the grid is tolerated.
    is_enough = (between or (error is not None and error.is_met)) and (limits is None or limits.is_enough)
    if error is None or is_enough or last.status is not Status.SOLVED:
        return None
    grid, begun = problem.grid, solutions[0].problem.grid
    if isinstance(grid, Instant) or isinstance(begun, Instant) or error.next_steps > _FINEST * begun.steps:
        return None
    for one in solutions[-3:]:
        own, limits = one.certificate.grid_error, one.certificate.between
        beyond = 0.0 if limits is None or limits.holds else limits.worst / TOLERATED
        ratios.append(max(np.inf if own is None else own.ratio, beyond, limits.cost / COSTLY if limits else 0.0))
    if len(ratios) == 3 and min(ratios[1:]) > _FALLS * ratios[0]:
        return None
    return problem.on_grid(grid.divided(error.next_steps), problem.integrator.refined())
