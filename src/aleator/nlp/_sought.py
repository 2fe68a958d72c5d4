"""The points that a search evaluates: in a box, by one number each, within a budget, the best of them kept."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.border import Progress
from aleator.nlp._program import NonlinearProgram

# Points that are compared with one another at most, among them all of the best.
_COMPARED, _BEST = 2500, 500
# A point begins a basin of its own if none within this distance, a part of the box, is better.
_APART = 0.05
# A point that violates a constraint by no more than this is near enough for derivatives.
NEAR = 1e-2
# The merit of a point that cannot be evaluated, in spreads of the objective: worse than any other.
_WALL = 1e6
# A spread of the objective below this part of it is rounding.
_ROUNDING = 1e-12


@final
class EndedError(Exception):
    """A search must end: its budget is spent, or the user or the model stopped it."""


class Found(NamedTuple):
    """Points with what is known of each: an objective that is not a number where the model could not be evaluated, and
    the largest violation.
    """

    points: Float[np.ndarray, "k n"]
    objectives: Float[np.ndarray, " k"]
    violations: Float[np.ndarray, " k"]


@final
class Sought:
    """The points of one search, in coordinates from 0 to 1 between the bounds of the free variables.

    A variable without two finite bounds is measured from the start, in typical magnitudes. A point's merit is its
    objective, in spreads over the first points, plus `weight` times its largest violation: an exact penalty, so that
    a minimum that meets the constraints is one of the merit if the weight is large enough.

    - `budget`: how many points may be evaluated, and for how long, s;
    - `size`: the number of free variables; `start`: shape (size,);
    - `lower`, `upper`: bounds in these coordinates, shape (size,), infinite where there is none;
    - `found`: the points evaluated, in order; `limit`: the number at which the present round ends;
    - `weight`: that of violations;
    - `halt`: what stopped the search, if anything did; `end`: why it ended, in words.
    """

    def __init__(
        self,
        program: NonlinearProgram,
        start: Float[np.ndarray, " n"],
        budget: tuple[int, float],
        progress: Progress,
        heed: Callable[[], None],
    ):
        self._program, self._progress, self._heed = program, progress, heed
        self._most, self._longest = budget
        self._free = np.flatnonzero(program.lower < program.upper)
        self._fixed = np.clip(start, program.lower, program.upper)
        lower, upper = program.lower[self._free], program.upper[self._free]
        closed = np.isfinite(upper) & np.isfinite(lower)
        self._origin = np.where(closed, lower, self._fixed[self._free])
        self._length = np.where(closed, upper - lower, program.variable_scale[self._free])
        self.lower, self.upper = (lower - self._origin) / self._length, (upper - self._origin) / self._length
        self.start = (self._fixed[self._free] - self._origin) / self._length
        self.size = len(self._free)
        self.weight, self.limit = 0.0, self._most
        self.halt: BaseException | None = None
        self.end = "its method ended"
        self._began = time.perf_counter()
        self._spread = 0.0
        self.found = Found(np.zeros((0, self.size)), np.zeros(0), np.zeros(0))

    @property
    def bounds(self) -> Any:
        """The bounds, as SciPy takes them."""
        return scipy.optimize.Bounds(self.lower, self.upper)

    @property
    def count(self) -> int:
        """How many points were evaluated."""
        return len(self.found.objectives)

    @property
    def is_spent(self) -> bool:
        """Whether the whole budget is spent."""
        return self.count >= self._most or (self.count > 0 and self.seconds >= self._longest)

    @property
    def is_over(self) -> bool:
        """Whether no further point may be evaluated."""
        return self.halt is not None or self.is_spent

    @property
    def seconds(self) -> float:
        """The time since the search began."""
        return time.perf_counter() - self._began

    def merits(self, points: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """The merits of some points, which are clipped to the bounds, from one call of the model.

        Raises `EndedError` if the budget is spent; points up to then count.
        """
        some = np.clip(np.atleast_2d(np.asarray(points, dtype=float)), self.lower, self.upper)
        left = max(min(self.limit, self._most) - self.count, 0)
        if left == 0 or self.is_over:
            raise EndedError
        found = self._evaluated(some[:left])
        if left < len(some) or self.is_over:
            raise EndedError
        return self._merits(found)

    def merit(self, point: Float[np.ndarray, " size"]) -> float:
        """The merit of one point."""
        return float(self.merits(point[None])[0])

    def candidates(self, most: int) -> list[Float[np.ndarray, " n"]]:
        """The best points, in the user's units, best first, that have no better neighbour; at least the start.

        A point near a better one belongs to the same basin (Rinnooy Kan and Timmer 1987). Points that violate little
        are ranked by their objective, which the penalty of a late round would hide.
        """
        least = np.min(self.found.violations, initial=np.inf, where=np.isfinite(self.found.objectives))
        points = self.ranked(max(NEAR, 2 * least)).points
        ranked = np.concatenate([points[:_BEST], points[_BEST :: 1 + max(len(points) - _BEST, 0) // _COMPARED]])
        chosen: list[Float[np.ndarray, " size"]] = []
        for rank, point in enumerate(ranked):
            if len(chosen) == most:
                break
            if not (np.abs(ranked[:rank] - point).max(axis=1, initial=0.0) < _APART).any():
                chosen.append(point)
        return [self.unscaled(one[None])[0] for one in chosen]

    def ranked(self, violation: float) -> Found:
        """The points that could be evaluated: those that violate nothing by more, by objective, then others, by
        violation; the start, if there is none.
        """
        known = np.isfinite(self.found.objectives)
        if not known.any():
            return Found(self.start[None], np.array([np.inf]), np.array([np.inf]))
        _, objectives, violations = self.found
        outside = violations > violation
        order = np.lexsort((np.where(outside, violations, objectives), outside, ~known))[: known.sum()]
        return Found(*(part[order] for part in self.found))

    def _merits(self, found: Found) -> Float[np.ndarray, " k"]:
        known = np.isfinite(found.objectives)
        self._spread = self._spread or _spread(found.objectives[known])
        merits = np.where(known, found.objectives, 0.0) / (self._spread or 1.0) + self.weight * found.violations
        return np.where(known, np.minimum(merits, _WALL), _WALL)

    def _evaluated(self, points: Float[np.ndarray, "k size"]) -> Found:
        program, places = self._program, self.unscaled(points)
        try:
            self._heed()
            if program.values is not None:
                objectives, constraints = program.values(places)
            else:
                every = [program.evaluate(one) for one in places]
                objectives, constraints = (np.array([one[part] for one in every]) for part in (0, 2))
        except BaseException as error:
            self.halt = error
            raise EndedError from error
        known = np.isfinite(objectives) & np.isfinite(constraints).all(axis=1)
        with np.errstate(invalid="ignore"):
            worst = np.max(program.limits.excess(constraints) / program.constraint_scale, axis=1, initial=0.0)
        found = Found(points, np.where(known, objectives, np.nan), np.where(known, worst, 0.0))
        self.found = Found(*(np.concatenate(both) for both in zip(self.found, found, strict=True)))
        self._progress("search", self.count, self._most)
        return found

    def unscaled(self, points: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k n"]:
        """Points in the user's units."""
        every = np.tile(self._fixed, (len(points), 1))
        every[:, self._free] = self._origin + points * self._length
        return np.clip(every, self._program.lower, self._program.upper)


def _spread(objectives: Float[np.ndarray, " k"]) -> float:
    """How far objectives differ: the middle half of them, else all; zero if they do by rounding alone."""
    if not objectives.size:
        return 0.0
    half = float(np.subtract(*np.quantile(objectives, [0.75, 0.25])))
    size = _ROUNDING * float(np.abs(objectives).max())
    return next((one for one in (half, float(np.ptp(objectives))) if one > size), 0.0)
