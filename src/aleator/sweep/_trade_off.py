"""`TradeOff`: a front of designs; which of them are efficient, the hypervolume they dominate, even places on it."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.border import real_array, refusal
from aleator._core.leaves import Drawn
from aleator.design import Expression
from aleator.solution import Solution
from aleator.sweep._printed import table


@final
@dataclass(frozen=True)
class TradeOff(Drawn):
    """Efficient designs: none is better in one wish without being worse in another. `print(trade_off)` lists them.

    - `names`: of the wishes, which are the expressions `wishes`; `values`: theirs, shape (points, wishes), in order of
      the first one;
    - `solutions`: the design at each point, with its certificate, as a solution of the given problem with the sum of
      the wishes times their `weights` as its objective, of which it is a stationary point (where the front is concave,
      not the least one); at the best design of a wish whose weights are not known, with that wish alone;
    - `best`: the least value of each wish alone, shape (wishes,), NaN where an interruption left it unknown; `worst`:
      its largest among the best designs of the wishes;
    - `weights`: how much the wishes count at each point, shape (points, wishes), by the multipliers: along the front,
      one unit more of the wish `i` buys `weights[i] / weights[j]` units less of the wish `j`. At the ends of a front
      they are those beside the end, and NaN where the front gets ever steeper, or nothing is known of it;
    - `asked`: how many designs were asked for. There are fewer where some were found again, `dominated` (so many), or
      not found: `failed` tells why;
    - `holes`: for two wishes and `method="boundary"`: the values of the first one between which no line ends at a
      design, as far as local searches tell: where the front has a gap;
    - `interrupted`: whether Ctrl-C ended it; the points found by then are included.
    """

    names: tuple[str, ...]
    wishes: tuple[Expression, ...]
    values: Float[np.ndarray, "points wishes"]
    solutions: tuple[Solution, ...]
    best: Float[np.ndarray, " wishes"]
    worst: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, "points wishes"]
    asked: int = 0
    dominated: int = 0
    holes: tuple[tuple[float, float], ...] = ()
    failed: tuple[str, ...] = ()
    interrupted: bool = False

    def hypervolume(self, reference: Sequence[float] | Float[np.ndarray, " wishes"] | None = None) -> float:
        """The volume of values that some point is better than, up to a reference; by default `worst`."""
        expected = f"{len(self.names)} finite numbers, one a wish"
        corner = self.worst if reference is None else real_array("hypervolume: reference", reference, expected)
        if corner.shape != self.worst.shape or not np.isfinite(corner).all():
            raise refusal("hypervolume: reference", expected, reference)
        return hypervolume(self.values, corner)

    def __str__(self) -> str:
        rows, count = [self.names, *([f"{one:.6g}" for one in row] for row in self.values)], len(self.values)
        said = f"{count} designs, each solved and certified; none is better than another in every wish"
        if count == 1 and not self.interrupted:
            said = "the wishes do not conflict: one design, solved, is best for all of them"
        elif count < self.asked:
            others = "" if self.interrupted else f": others were dominated ({self.dominated}) or found again"
            said += f"; {self.asked} were asked for{others}"
        holes = [f"no design was found between {self.names[0]} = {a:.6g} and {b:.6g}" for a, b in self.holes]
        return table(rows, said, *holes, *(f"no design: {one}" for one in self.failed), interrupted=self.interrupted)


class Line(NamedTuple):
    """A line on which all wishes get better alike, through some values of theirs, and where a search on it starts."""

    through: Float[np.ndarray, " wishes"]
    start: Mapping[str, Any] | None = None


def efficient(points: Float[np.ndarray, "n wishes"], tolerance: Float[np.ndarray, " wishes"]) -> Bool[np.ndarray, " n"]:
    """Which points no other one dominates: is as good in every wish, and better in one by more than its tolerance.

    As good is what is worse by at most a tenth of the tolerance, so that steep ends of a front are kept.
    """
    kept = np.ones(len(points), dtype=bool)
    for i, point in enumerate(points):
        others = points[kept & (np.arange(len(points)) != i)]
        as_good = (others <= point + 0.1 * tolerance).all(axis=1)
        better = (others < point - tolerance).any(axis=1)
        kept[i] = not (as_good & better).any()
    return kept


def hypervolume(points: Float[np.ndarray, "n wishes"], reference: Float[np.ndarray, " wishes"]) -> float:
    """The volume of what some point is better than, up to a reference that is worse than all of them.

    By slices along the last wish (Zitzler 1999); points beyond the reference add nothing.
    """
    inside = points[(points < reference).all(axis=1)]
    if not len(inside):
        return 0.0
    if inside.shape[1] == 1:
        return float(reference[0] - inside.min())
    inside = inside[np.argsort(inside[:, -1], kind="stable")]
    depths = np.append(inside[1:, -1], reference[-1]) - inside[:, -1]
    return sum(
        hypervolume(inside[: i + 1, :-1], reference[:-1]) * float(depth) for i, depth in enumerate(depths) if depth > 0
    )


def across(scaled: Float[np.ndarray, "*k wishes"]) -> Float[np.ndarray, "*k wishes"]:
    """The places of scaled wishes beside one another, seen along the direction in which all get better alike."""
    return scaled - scaled.mean(axis=-1, keepdims=True)


def simplex(size: int, count: int) -> Float[np.ndarray, "k wishes"]:
    """At least so many points spread evenly over the inside and the edges of a simplex, without its corners."""
    parts, points = 1, np.zeros((0, size))
    while len(points) < count:
        parts *= 2
        points = _lattice(size, parts)
    return points


def box(size: int, count: int) -> Float[np.ndarray, "k wishes"]:
    """Starts of at least so many parallel lines that pass evenly through a unit box in the direction of its diagonal.

    They are points of a lattice on the plane through the box's middle whose line meets it, for fronts of which no
    simplex between the best designs is known.
    """
    parts, points = 1, np.zeros((0, size))
    while len(points) < count:
        parts *= 2
        shifted = (size - 1) * (_lattice(size, parts) - 1 / size) + 0.5
        points = shifted[np.ptp(shifted, axis=1) < 1.0]
    return points


def _lattice(size: int, parts: int) -> Float[np.ndarray, "k wishes"]:
    """All sums of multiples of `1 / parts` that make one, but for the corners (Das and Dennis 1998)."""
    bars = np.array(list(itertools.combinations(range(parts + size - 1), size - 1)))
    every = np.diff(bars, axis=1, prepend=-1, append=parts + size - 1) - 1
    return every[every.max(axis=1) < parts] / parts
