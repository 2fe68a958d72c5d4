"""Limits by CHECK, in one table: whether each holds on a finer grid and between the instants, whether the problem's own
grid tells that, and the margins that enforce it.

At the knots of trajectories outputs may jump, such as torques of a motion of degree 2. An instant has the value of one
side of a jump only, so that the sides before and after it are judged separately.
"""

import functools
import itertools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import Check, row_sizes
from aleator.certification._fresh import parts_in
from aleator.design import Constraint, Expression, Peak, Statistic, functionals_of, instants_of, is_over_time, path_of
from aleator.dynamics import Simulation
from aleator.nlp import NonlinearProgram
from aleator.solution import Between
from aleator.statistics import Std, Variance
from aleator.trajectories import BSpline, piecewise_in
from aleator.transcription import NOISE, AbstractTranscribed, bound_size, excess_of
from aleator.uncertainty import at_means, realise

OWN_ERROR = 1.25
"""Allowance for the error of the finer grid itself, which is much smaller."""

# An excess on a finer grid is an error of the grid if the grids differ by at least this part of it.
_OF_THE_GRID = 0.1
# A grid that differs from a finer one by more than these parts of a limit's size does not tell whether it holds: by
# the first if it is no further from its bound than that, by the second wherever it is.
_NEAR_BOUND, _ANYWHERE = 0.05, 0.25
# A limit of zero is broken by more than this part of its values, which follow the decisions if they are nearly straight
# over steps of this part of a typical magnitude.
_BROKEN, _MOVED, _STRAIGHT = 1e-3, 1e-3, 0.1
# A jump exceeds this many changes between neighbouring fine instants, and this part of the values.
_STEEP, _LEAST = 5.0, 1e-6
# A knot within this many steps of an instant coincides with it up to rounding.
_AT = 1e-6


class Limit(NamedTuple):
    """A limit on both grids, a path with a row for each instant, others with one row.

    - `own`, `fine`: its values at the instants of the problem's grid, and of that with `factor` times as many steps;
    - `size`: its smaller bound or, where that is zero, how large its expression may be;
    - `times`: the instants of its own rows, s; NaN for a limit that is no path.
    """

    constraint: Constraint
    own: Float[np.ndarray, "instants entries"]
    fine: Float[np.ndarray, "finer entries"]
    factor: int
    size: float
    times: Float[np.ndarray, " instants"]

    @property
    def beyond(self) -> Float[np.ndarray, " finer"]:
        """The largest excess over the bounds in each row of the finer grid."""
        return excess_of(self.constraint, self.fine).max(axis=1)

    def broken(self, accuracy: float) -> tuple[float, str]:
        """The excess on the finer grid over the size, and a sentence on it; zero and empty if the limit holds there.

        A difference that is equal on both grids is no error of the grid, however small its tolerance.
        """
        if not np.isfinite(self.fine).all():
            return np.inf, f"on a finer grid {self} is not a number"
        excess, changed = float(self.beyond.max()), float(np.abs(self.fine - self.own).max())
        if not (excess > accuracy * self.size > 0 and changed > _OF_THE_GRID * excess):
            return 0.0, ""
        return excess / self.size, f"on a finer grid {self} exceeds its bound by {excess:.2g}"

    def unresolved(self) -> tuple[float, str]:
        """The largest difference from the finer grid, over the size, that leaves open on which side of its bound the
        limit is there, and a sentence on it; zero and empty if there is none.

        Paths are compared with what they reach within a step, so that a jump that lies on the other side of an instant
        there makes no difference.
        """
        if not self.size > 0:
            return 0.0, ""
        windows = np.arange(len(self.own))[:, None] * self.factor + np.arange(-self.factor, self.factor + 1)
        around, there = self.fine[np.clip(windows, 0, len(self.fine) - 1)], self.fine[:: self.factor]
        away = OWN_ERROR * np.maximum(self.own - around.max(axis=1), around.min(axis=1) - self.own)
        slack = -excess_of(self.constraint, there)
        if any(isinstance(part, Peak) for part in functionals_of((self.constraint.expression,))):
            slack = np.full_like(slack, np.inf)  # what a peak exceeds between the instants is held there by margins
        magnitude = max(self.size, float(np.abs(self.own).max()), float(np.abs(self.fine).max()))
        is_near = (away > _NEAR_BOUND * self.size) & (away > np.abs(slack))
        doubtful = np.where(is_near | (away > _ANYWHERE * magnitude), away, 0.0)
        row, entry = np.unravel_index(int(np.argmax(doubtful)), doubtful.shape)
        if not doubtful[row, entry] > 0:
            return 0.0, ""
        when = "" if np.isnan(self.times[row]) else f" at t = {self.times[row]:.4g} s"
        return float(doubtful[row, entry] / self.size), (
            f"{self} differs by {doubtful[row, entry]:.2g}{when} on a finer grid, so that these steps do not tell "
            "whether it holds"
        )

    def __str__(self) -> str:
        return f"'{self.constraint.name}' ({self.constraint})"


def limits_at(check: Check) -> list[Limit]:
    """All limits of a problem, on both grids."""
    transcribed, limits = check.transcribed, []
    rows = functools.cache(lambda: row_sizes(transcribed, check.point))
    each = zip(check.problem.constraints, check.meaning.constraints, check.values[1:], transcribed.rows, strict=True)
    for one, own, fine, place in each:
        times = instants_of(one, check.problem.grid, lambda: check.times)
        size = bound_size(one) or max(reach_of(one.expression, check), float(np.max(rows()[place])))
        own = transcribed.at_instants(one, own).reshape(len(times), -1)
        fine = fine.reshape(len(fine) if one.is_path else 1, -1)
        limits.append(Limit(one, own, fine, check.factor, size, times))
    return limits


def reach_of(expression: Expression, check: Check) -> float:
    """The possible size of an expression, from that of its functionals; zero if unknown."""

    def reach(atom: Any) -> float:
        if not isinstance(atom, Statistic):
            return 0.0
        largest = check.functionals[atom.functionals[0]].reach
        if isinstance(atom.kind, Variance):
            return largest**2
        # A spread is no larger than the functional itself.
        return largest if atom.kind.speaks_of_one_system or isinstance(atom.kind, Std) else 0.0

    terms = zip(expression.factors, expression.atoms, strict=True)
    return sum(abs(float(factor)) * sum(map(reach, atom.parts)) for factor, atom in terms)


def indistinct_limit(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check | None
) -> str:
    """A sentence on a limit of zero that is broken by values so small that they count as rounding, though they follow
    the decisions, as those of an output in too large a unit do; empty if there is none.

    Nothing tells these from rounding of a constant, such as `sin(pi)`, that a decision multiplies.
    """
    problem, every = transcribed.problem, transcribed.at(point).constraints

    def is_suspect(one: Constraint, values: Float[np.ndarray, "..."]) -> bool:
        largest = float(np.max(np.abs(values), initial=0.0))
        is_broken = float(excess_of(one, values).max(initial=0.0)) > _BROKEN * largest
        small = is_broken and largest <= NOISE and not bound_size(one)
        return small and (check is None or reach_of(one.expression, check) <= NOISE)

    suspects = [i for i, (one, own) in enumerate(zip(problem.constraints, every, strict=True)) if is_suspect(one, own)]
    if not suspects:
        return ""
    here, lower, upper = transcribed.decisions(point), *map(problem.placements.vector, ("lower", "upper"))
    step = _MOVED * transcribed.decisions(transcribed.program.variable_scale)
    step *= np.random.default_rng(0).uniform(0.5, 1.5, here.size) * np.where(here + 5 * step > upper, -1, 1)
    moved = [transcribed.point(np.clip(here + i * step, lower, upper)) for i in range(4)]
    values = [transcribed.at(one).constraints for one in moved]
    for i in suspects:
        along = np.array([one[i] for one in values])
        change, bend = (float(np.linalg.norm(np.diff(along, order, axis=0))) for order in (1, 2))
        if np.max(np.abs(along)) <= NOISE and bend < _STRAIGHT * change:
            one, excess = problem.constraints[i], float(excess_of(problem.constraints[i], every[i]).max())
            return (
                f"'{one.name}' ({one}) is broken by {excess:.2g}. Values so small count as rounding of zero, but these "
                "follow the decisions: let the output be in a smaller unit; or, if they are rounding, drop the limit"
            )
    return ""


# --- Between the instants --------------------------------------------------------------------------------------------

Margins = tuple[Float[np.ndarray, " limited"] | None, ...]
"""By how much the bounds of each constraint are moved inwards wherever limits over time are imposed; None for limits on
no path or peak, and for equalities, of which no margin can enforce both sides.
"""


def excess_between(check: Check) -> tuple[Between, Margins]:
    """How far a problem's limits over time are exceeded on a finer grid at most, and how far each bound must move
    inwards so that the worst value near each instant meets it, negative where it may move outwards.
    """
    transcribed, between, shifts = check.transcribed, Between(check.factor, 0.0, "", 0.0), []
    decisions = jax_array(transcribed.decisions(check.point))
    model = realise(at_means(check.problem.simulation), jax_array(np.zeros(0)), decisions)
    for limit, scale in zip(limits_at(check), transcribed.scales, strict=True):
        one, rows, shift, path = limit.constraint, limit.beyond, None, path_of(limit.constraint)
        if is_over_time(one):
            # Places in steps of the finer grid, with the excess before and after.
            sides = [
                (place, float(excess_of(one, before).max()), float(excess_of(one, after).max()))
                for place, before, after in (jumps(limit.fine, _knots(model.of(path))) if path else [])
            ]
            if float(one.lower) != float(one.upper):
                shift = _shifts(rows, transcribed.limited(path) * (len(rows) - 1), sides) if path else rows
            # NaN counts as the largest excess.
            candidates = [(float(rows.max()), int(np.argmax(rows))), *((max(side[1:]), int(side[0])) for side in sides)]
            largest, place = max((np.inf if np.isnan(most) else most, place) for most, place in candidates)
            largest /= bound_size(one) or scale
            if largest > between.worst:
                between = Between(check.factor, largest, one.name, float(limit.times[place // limit.factor]))
        shifts.append(shift)
    return between, tuple(shifts)


def _knots(model: Simulation) -> Float[np.ndarray, " knots"]:
    """The interior knots of splines and nodes of controls of a realisation, as fractions of its time."""
    parts = model.system, model.inputs
    ends = (one.breaks() for one in (*parts_in(parts, BSpline), *piecewise_in(parts)))
    fractions = np.concatenate([np.zeros(0), *ends])
    return np.unique(fractions[(fractions > 0) & (fractions < 1)])


def jumps(
    values: Float[np.ndarray, "finer entries"], at: Float[np.ndarray, " knots"]
) -> list[tuple[float, Float[np.ndarray, " entries"], Float[np.ndarray, " entries"]]]:
    """The jumps of a path at knots: place in steps of the finer grid, values before and after, from straight lines."""
    last, size, every = len(values) - 1, float(np.abs(values).max(initial=0.0)), []
    for place in (at * last).tolist():
        left, right = int(np.ceil(place - _AT)) - 1, int(np.floor(place + _AT)) + 1
        if left < 1 or right > last - 1:
            continue
        rising, going = values[left] - values[left - 1], values[right + 1] - values[right]
        before, after = values[left] + rising * (place - left), values[right] - going * (right - place)
        change = max(float(np.abs(rising).max()), float(np.abs(going).max()))
        if float(np.abs(after - before).max()) > _STEEP * change + _LEAST * size:
            every.append((place, before, after))
    return every


def _shifts(
    beyond: Float[np.ndarray, " finer"],
    places: Float[np.ndarray, " limited"],
    sides: list[tuple[float, float, float]],
) -> Float[np.ndarray, " limited"]:
    """The shifts at both ends of each interval that its worst value requires, in proportion to their proximity.

    - `places`: the ends of the intervals, in steps of the finer grid.

    Shifts `e (1 - s)` and `e s`, divided by `(1 - s)² + s²`, change a straight line between them by `e` at the fraction
    `s`. In an interval with jumps, each end answers for its own side of them only.
    """
    low, high = np.ceil(places[:-1] - _AT).astype(int), np.floor(places[1:] + _AT).astype(int)
    which = np.minimum(low[:, None] + np.arange((high - low).max() + 1), high[:, None])
    inside = np.where((low <= high)[:, None], beyond[which], -np.inf)
    worst = (np.arange(len(low)), np.argmax(inside, axis=1))
    excess, s = inside[worst], np.clip((which[worst] - places[:-1]) / np.diff(places), 0.0, 1.0)
    share = np.stack([1 - s, s]) / ((1 - s) ** 2 + s**2)
    first, last = np.where(excess > 0, share * excess, excess)
    fine = np.arange(len(beyond))
    for i, (begin, end) in enumerate(itertools.pairwise(places)) if sides else ():
        here = [side for side in sides if begin - _AT <= side[0] <= end + _AT]
        if here:
            (earliest, before, _), (latest, _, after) = here[0], here[-1]
            # Exactly at a jump, rounding decides which side an instant's value belongs to.
            left, right = (begin <= fine) & (fine < earliest - _AT), (latest + _AT < fine) & (fine <= end)
            first[i] = max([before, *beyond[left]]) if earliest > begin + _AT else -np.inf
            last[i] = max([after, *beyond[right]]) if latest < end - _AT else -np.inf
    return np.maximum(np.append(first, -np.inf), np.append(-np.inf, last))


def margins_for(margins: Margins | None, shifts: Margins, *, relax: bool) -> Margins:
    """Margins updated by shifts, None for none yet. With `relax` they shrink where limits hold with slack."""
    before = [0.0] * len(shifts) if margins is None else margins
    return tuple(
        None if old is None or new is None else np.maximum(old + (new if relax else 1.2 * np.maximum(new, 0.0)), 0.0)
        for old, new in zip(before, shifts, strict=True)
    )


def tightened(transcribed: AbstractTranscribed, margins: Margins) -> NonlinearProgram:
    """The program with the bounds of path constraints moved inwards by margins."""
    program = transcribed.program
    lower, upper = program.constraint_lower.copy(), program.constraint_upper.copy()
    for rows, margin in zip(transcribed.rows, margins, strict=True):
        if margin is not None:
            moved = np.repeat(margin, (rows.stop - rows.start) // len(margin))
            lower[rows], upper[rows] = lower[rows] + moved, upper[rows] - moved
    return replace(program, constraint_lower=lower, constraint_upper=upper)
