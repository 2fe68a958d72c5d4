"""Scenarios: the realisations of the model at which limits on the worst case are imposed.

A limit on the worst case is a limit on every realisation. The program imposes it at a few of them, which are added when
they are found to break it, and dropped when they no longer bind: the method of cutting sets (Mutapcic and Boyd, 2009,
Cutting-set methods for robust convex optimization with pessimizing oracles). They are stored in slots, whose germ
points are data and whose bounds are infinite while they are empty, so that another scenario compiles nothing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError
from aleator.design import Problem, is_worst_case

_FEWEST_SLOTS = 8


class Scenarios(NamedTuple):
    """Germ points in slots: `points` of shape (slots, variables); `used`: the slots at which limits are imposed."""

    points: Float[np.ndarray, "slots variables"]
    used: Bool[np.ndarray, " slots"]

    @property
    def held(self) -> Float[np.ndarray, "scenarios variables"]:
        """The points at which limits are imposed."""
        return self.points[self.used]

    @classmethod
    def of(cls, points: Float[np.ndarray, "scenarios variables"]) -> "Scenarios":
        """Some points in as many slots as they need."""
        slots = _FEWEST_SLOTS
        while slots < len(points):
            slots *= 2
        # Empty slots hold a copy: the model is evaluated there too.
        return cls(np.resize(points, (slots, points.shape[1])), np.arange(slots) < len(points))

    def joined(self, new: Float[np.ndarray, "new variables"], idle: Bool[np.ndarray, " slots"]) -> "Scenarios":
        """Add points: in empty slots, then in the place of `idle` ones, then in twice as many slots.

        The others keep their slots, so that multipliers of their rows remain theirs.
        """
        places = np.concatenate([np.flatnonzero(~self.used), np.flatnonzero(self.used & idle)])
        if len(places) < len(new):
            wider = Scenarios.of(np.concatenate([self.points, self.points]))
            used = np.concatenate([self.used, np.zeros(len(wider.used) - len(self.used), dtype=bool)])
            return Scenarios(wider.points, used).joined(new, np.zeros(len(used), dtype=bool))
        points, used = self.points.copy(), self.used.copy()
        points[places[: len(new)]], used[places[: len(new)]] = new, True
        return Scenarios(points, used)


def germ_box(problem: Problem) -> Float[np.ndarray, "variables 2"]:
    """The ends of each germ variable, between which realisations are searched.

    Raises `ProblemError` if a variable is unbounded.
    """
    germs = problem.placements.germs
    unbounded = [name for name, germ in germs.items() if not np.all(np.isfinite(germ.support()))]
    if unbounded:
        limits = dict.fromkeys(one.name for one in problem.constraints if is_worst_case(one))
        raise ProblemError(
            f"worst_case of {', '.join(map(repr, limits))}: {', '.join(map(repr, unbounded[:5]))} can take values "
            "without bound, of which none is the worst; use bounded distributions such as Uniform or Beta that are "
            "not correlated, or probability=0.999 in its place."
        )
    return np.array([germ.support() for germ in germs.values()], dtype=float).reshape(-1, 2)


def first_scenarios(problem: Problem) -> Scenarios | None:
    """Two opposite corners of the germ's box to begin with; None if there is no limit on the worst case."""
    if not any(map(is_worst_case, problem.constraints)):
        return None
    box = germ_box(problem)
    return Scenarios.of(box.T) if len(box) else Scenarios(np.zeros((1, 0)), np.ones(1, dtype=bool))
