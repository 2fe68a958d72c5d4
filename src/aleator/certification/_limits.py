"""Limits by CHECK, in one table: whether each holds on a finer grid, and whether the problem's own grid tells that."""

import functools
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.certification._check import Check, row_sizes
from aleator.design import Constraint, Expression, Peak, Statistic, functionals_of, instants_of
from aleator.statistics import Std, Variance
from aleator.transcription import NOISE, AbstractTranscribed, bound_size, excess_of

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
