"""What many starts led to: which of their ends are one local optimum, and how sure one may be of the best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.leaves import Drawn, Printed
from aleator.nlp import Searched
from aleator.solution import Solution

# Objectives, or decisions, with a smaller relative difference belong to one optimum, and so do objectives whose
# difference is below this part of those at the starts, since they may be zero.
_SAME, _NONE = 1e-4, 1e-9
# With fewer random starts, or with not this many more than optima, nothing can be said of those not seen: there the
# estimate is a number without meaning (Boender and Rinnooy Kan 1987 need two more for its mean, three for its spread).
_FEWEST, _MORE = 6, 3


def alike(
    objectives: Sequence[float], points: Sequence[Float[np.ndarray, " n"]], histories: Sequence[Searched | None]
) -> list[list[int]]:
    """The local optima at which searches ended, best first: the indices of the ends that belong to each.

    Mirrored designs count as one, by their objective, and so do equal designs. `histories`: of the searches, which tell
    the magnitude of the objective.
    """
    size = np.max(np.abs(points), axis=0, initial=1e-12) if points else np.zeros(0)
    first = np.array([abs(one.objectives[0]) for one in histories if one is not None and len(one.objectives)])
    first = first[np.isfinite(first)]
    least = _NONE * float(np.median(first)) if first.size else 0.0
    groups: list[list[int]] = []
    for i in np.argsort(objectives, kind="stable").tolist():
        best = groups[-1][0] if groups else None
        if best is not None and (
            abs(objectives[i] - objectives[best]) <= max(_SAME * max(abs(objectives[i]), abs(objectives[best])), least)
            or np.all(np.abs(points[i] - points[best]) < _SAME * size)
        ):
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _listed(optima: Sequence[tuple[float, int]], starts: int) -> list[str]:
    """Local optima in lines: the objective of each, and how many of the starts led to it."""
    failed = starts - sum(count for _, count in optima)
    return [
        "local optima (equal objectives count as one)",
        *(f"{objective:14.8g}  from {count} of {starts} starts" for objective, count in optima),
        *([f"{failed} starts failed"] if failed else []),
    ]


@final
@dataclass(frozen=True)
class Starts(Drawn):
    """A problem solved from several starts. `print(starts)` lists its local optima.

    - `solutions`: one per start, in order, failed ones included;
    - `interrupted`: whether it was stopped early; the solutions finished by then are included.
    """

    solutions: tuple[Solution, ...]
    interrupted: bool = False

    @property
    def best(self) -> Solution:
        """The best solved one; if none is solved, the least violated."""
        solved = [one for one in self.solutions if one.ok]
        if solved:
            return min(solved, key=lambda one: one.objective)
        return min(self.solutions, key=lambda one: np.nan_to_num(one.certificate.violation, nan=np.inf))

    @property
    def optima(self) -> tuple[tuple[Solution, int], ...]:
        """The local optima, best first, each with the number of starts that led to it.

        Solutions with the same objective count as one, mirrored plans included, and so do those with the same
        decisions, since the objective may be zero.
        """
        solved, histories = [one for one in self.solutions if one.ok], [one.effort.visited for one in self.solutions]
        groups = alike([one.objective for one in solved], [one.vector for one in solved], histories)
        return tuple((solved[group[0]], len(group)) for group in groups)

    def __str__(self) -> str:
        optima = [(solution.objective, count) for solution, count in self.optima]
        ended = ["interrupted by the user"] if self.interrupted else []
        return "\n".join([*_listed(optima, len(self.solutions)), *ended])


@final
@dataclass(frozen=True)
class Optimum(Printed):
    """A local optimum of the program.

    - `objective`, `decisions`: by name;
    - `starts`: how many local searches ended there; `random`: how many of these began at a random point, whose share
      is that of its basin.
    """

    objective: float
    decisions: dict[str, Any]
    starts: int
    random: int

    def __str__(self) -> str:
        decided = ", ".join(
            f"{name} = {np.array2string(np.asarray(one), precision=5)}" for name, one in self.decisions.items()
        )
        return f"{self.objective:.8g} from {self.starts} starts ({self.random} of them random), at {decided}"


@final
@dataclass(frozen=True)
class Portfolio(Drawn):
    """What a global search and many local ones found. `print(portfolio)` lists the optima.

    - `best`: the best optimum with its certificate; if that fails, the next one whose certificate stands; if there is
      none, the least violated design, with the reason;
    - `optima`: different local optima of the program, best first;
    - `starts`, `random`: local searches in all, and from random starts; `solved`: those of the random ones that ended
      at an optimum;
    - `searched`: the history of the global search; None if there was none;
    - `proven`: whether no design can be better, because the objective is at its lower bound;
    - `interrupted`: whether Ctrl-C ended it; what was found by then is kept, and certified.
    """

    best: Solution
    optima: tuple[Optimum, ...]
    starts: int
    random: int
    solved: int
    searched: Searched | None
    proven: bool = False
    interrupted: bool = False

    @property
    def seen_at_random(self) -> int:
        """How many optima random starts have led to."""
        return sum(one.random > 0 for one in self.optima)

    @property
    def unseen(self) -> float:
        """The expected share of starts that lead to optima not seen yet: `w (w + 1) / (n (n - 1))`.

        For `w` optima seen from `n` uniform random starts (Boender and Rinnooy Kan 1987). 1 for too few starts to say
        anything: fewer than six, or than three more than optima.
        """
        w, n = self.seen_at_random, self.solved
        return w * (w + 1) / (n * (n - 1)) if n >= max(_FEWEST, w + _MORE) else 1.0

    def sure(self) -> str:
        """How sure one may be that no design is better, in words."""
        if self.proven:
            return "No design is better: the objective is at its lower bound."
        if self.unseen == 1.0:
            return (
                f"Too few random starts ended at an optimum to say how many others there are: {self.solved}, at "
                f"{self.seen_at_random} optima. Nothing can be said of designs not seen; take more starts."
            )
        best = self.optima[0]
        found = f"{best.random} of {self.solved} random starts" if best.random else "Only the global search"
        return (
            f"{found} led to the best one; a further random start would lead to an optimum not seen yet with a "
            f"probability of about {self.unseen:.0%} (Boender and Rinnooy Kan 1987)."
        )

    def __str__(self) -> str:
        return "\n".join(
            [
                *_listed([(one.objective, one.starts) for one in self.optima], self.starts),
                *([str(self.searched)] if self.searched else []),
                f"best: {self.best.objective:.8g}, {self.best.why()}",
                *(["interrupted by the user"] if self.interrupted else []),
                self.sure(),
            ]
        )
