"""`TradeOff`: what each wish costs the others, on a front of designs of which none is better in all."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.shown import Drawn
from aleator.design import Expression
from aleator.solution import Solution
from aleator.sweep._hypervolume import hypervolume


@final
@dataclass(frozen=True)
class TradeOff(Drawn):
    """Efficient designs: none is better in one wish without being worse in another. `print(trade_off)` lists them.

    - `names`: of the wishes, which are the expressions `wishes`; `values`: theirs, shape (points, wishes), in order of
      the first one;
    - `solutions`: the design at each point, with its certificate;
    - `best`: the least value of each wish alone, shape (wishes,); `worst`: its largest among these anchors;
    - `weights`: how much the wishes count at each point, shape (points, wishes), by the multipliers: along the front,
      one unit more of the wish `i` buys `weights[i] / weights[j]` units less of the wish `j`;
    - `dominated`: how many designs were found that others are better than in every wish; `failed`: why points have no
      design;
    - `interrupted`: whether Ctrl-C ended it; the points found by then are included.
    """

    names: tuple[str, ...]
    wishes: tuple[Expression, ...]
    values: Float[np.ndarray, "points wishes"]
    solutions: tuple[Solution, ...]
    best: Float[np.ndarray, " wishes"]
    worst: Float[np.ndarray, " wishes"]
    weights: Float[np.ndarray, "points wishes"]
    dominated: int = 0
    failed: tuple[str, ...] = ()
    interrupted: bool = False

    def hypervolume(self, reference: Sequence[float] | Float[np.ndarray, " wishes"] | None = None) -> float:
        """The volume of values that some point is better than, up to a reference; by default `worst`."""
        corner = self.worst if reference is None else np.asarray(reference, dtype=float)
        if corner.shape != self.worst.shape:
            raise ProblemError(
                f"hypervolume: expected a reference of {len(self.names)} numbers, one a wish; received {reference!r}."
            )
        return hypervolume(self.values, corner)

    def __str__(self) -> str:
        width = max(12, *(len(name) + 1 for name in self.names))
        heading = "".join(f"{name:>{width}}" for name in self.names)
        rows = ["".join(f"{one:>{width}.6g}" for one in row) for row in self.values]
        several = f"{len(rows)} designs, each solved and certified; none is better than another in every wish"
        notes = [
            several if len(rows) > 1 else "the wishes do not conflict: one design, solved, is best for all of them",
            *([f"{self.dominated} designs were dominated by others"] if self.dominated else []),
            *(f"no design: {one}" for one in self.failed),
            *(["interrupted by the user"] if self.interrupted else []),
        ]
        return "\n".join([heading, *rows, *notes])
