"""Scenarios: the realisations of the model at which limits on the worst case are imposed.

A limit on the worst case is a limit on every realisation. The program imposes it at a few of them, which are added when
they are found to break it, and dropped when they no longer bind: the method of cutting sets (Mutapcic and Boyd, 2009,
Cutting-set methods for robust convex optimization with pessimizing oracles). They are stored in slots, whose germ
points are data and whose bounds are infinite while they are empty, so that another scenario compiles nothing.

A limit at the collocation points is imposed at these alone: they are in the first slots, and stay there.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator.design import Problem, is_at_points, is_worst_case

_FEWEST_SLOTS = 8


class Scenarios(NamedTuple):
    """Germ points in slots: `points` of shape (slots, variables).

    - `used`: the slots at which limits on the worst case are imposed;
    - `collocated`: how many slots, the first ones, hold the collocation points; 0 if no limit is at these.
    """

    points: Float[np.ndarray, "slots variables"]
    used: Bool[np.ndarray, " slots"]
    collocated: int = 0

    @property
    def held(self) -> Float[np.ndarray, "scenarios variables"]:
        """The points at which limits on the worst case are imposed."""
        return self.points[self.used]

    @property
    def fixed(self) -> Bool[np.ndarray, " slots"]:
        """The slots of the collocation points."""
        return np.arange(len(self.used)) < self.collocated

    @property
    def found(self) -> Float[np.ndarray, "scenarios variables"]:
        """The points at which limits on the worst case are imposed, but for the collocation points."""
        return self.points[self.used & ~self.fixed]

    @classmethod
    def of(cls, points: Float[np.ndarray, "scenarios variables"]) -> "Scenarios":
        """Some points in as many slots as they need."""
        slots = _FEWEST_SLOTS
        while slots < len(points):
            slots *= 2
        # Empty slots hold a copy: the model is evaluated there too.
        return cls(np.resize(points, (slots, points.shape[1])), np.arange(slots) < len(points))

    def beginning(self, points: Float[np.ndarray, "scenarios variables"]) -> "Scenarios":
        """The collocation points if they are held, and other points in the place of the present ones."""
        return Scenarios.of(np.concatenate([self.points[self.fixed], points]))._replace(collocated=self.collocated)

    def joined(self, new: Float[np.ndarray, "new variables"], idle: Bool[np.ndarray, " slots"]) -> "Scenarios":
        """Add points: in empty slots, then in the place of `idle` ones, then in twice as many slots.

        The others keep their slots, so that multipliers of their rows remain theirs.
        """
        idle = idle & ~self.fixed
        places = np.concatenate([np.flatnonzero(~self.used), np.flatnonzero(self.used & idle)])
        if len(places) < len(new):
            wider = Scenarios.of(np.concatenate([self.points, self.points]))
            used = np.concatenate([self.used, np.zeros(len(wider.used) - len(self.used), dtype=bool)])
            return Scenarios(wider.points, used, self.collocated).joined(new, np.zeros(len(used), dtype=bool))
        points, used = self.points.copy(), self.used.copy()
        points[places[: len(new)]], used[places[: len(new)]] = new, True
        return Scenarios(points, used, self.collocated)


def germ_box(problem: Problem) -> Float[np.ndarray, "variables 2"]:
    """The ends of each germ variable, between which realisations are searched.

    Raises `ProblemError` if a variable is unbounded.
    """
    ranges = dict[str, tuple[float, float]]()
    for place, distribution in problem.placements.distributions.items():
        germs = distribution.germs(place)
        is_alone = distribution.dependence is None
        ranges |= {name: distribution.reach() if is_alone else germ.support() for name, germ in germs.items()}
    unbounded = [name for name, ends in ranges.items() if not np.all(np.isfinite(ends))]
    if unbounded:
        limits = dict.fromkeys(one.name for one in problem.constraints if is_worst_case(one))
        raise ProblemError(
            f"worst_case of {', '.join(map(repr, limits))}: {', '.join(map(repr, unbounded[:5]))} can take values "
            "without bound, of which none is the worst; use bounded distributions such as Uniform or Beta that are "
            "not correlated, al.Toleranced of a known capability, whose zone counts, or probability=0.999 instead."
        )
    return np.array(list(ranges.values()), dtype=float).reshape(-1, 2)


def first_scenarios(problem: Problem, points: Float[np.ndarray, "points variables"]) -> Scenarios | None:
    """Two opposite corners of the germ's box to begin with, and the collocation points if limits are at these.

    None if there is no limit on realisations.
    """
    worst, collocated = any(map(is_worst_case, problem.constraints)), any(map(is_at_points, problem.constraints))
    if not worst and not collocated:
        return None
    box = germ_box(problem) if worst else np.zeros((0, 2))
    if not collocated:
        return Scenarios.of(box.T) if len(box) else Scenarios(np.zeros((1, 0)), np.ones(1, dtype=bool))
    scenarios = Scenarios(points, np.ones(len(points), dtype=bool), len(points))
    return scenarios.beginning(box.T) if len(box) else scenarios
