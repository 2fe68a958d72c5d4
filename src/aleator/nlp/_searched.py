"""`Searched`: the history of a solve."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Drawn


@final
@dataclass(frozen=True)
class Searched(Drawn):
    """What a search, or a local solver, evaluated in order. Of a search: before its best point was polished.

    - `method`: its name and version;
    - `objectives`: shape (evaluations,), in the unit of the objective; NaN where the model could not be evaluated;
    - `violations`: the largest of each point, relative to the constraints' magnitudes, shape (evaluations,);
    - `end`: why it ended, in words; `seconds`: wall-clock time.
    """

    method: str
    objectives: Float[np.ndarray, " evaluations"]
    violations: Float[np.ndarray, " evaluations"]
    end: str
    seconds: float

    @property
    def evaluations(self) -> int:
        """How many points were evaluated."""
        return len(self.objectives)

    def best(self, violation: float = 1e-2) -> Float[np.ndarray, " evaluations"]:
        """The least objective so far among points that violate nothing by more than `violation`; NaN before any."""
        held = np.where(self.violations <= violation, self.objectives, np.nan)
        least = np.fmin.accumulate(held) if len(held) else held
        return np.asarray(least)

    def __str__(self) -> str:
        failed = int(np.isnan(self.objectives).sum())
        said = f", {failed} of them not finite" if failed else ""
        return f"{self.method}: {self.evaluations} evaluations{said} in {self.seconds:.2f} s; {self.end}"


def joined(histories: Sequence[Searched]) -> Searched | None:
    """Histories one after the other as one, under the name and the end of the last; None if there is none."""
    if not histories:
        return None
    last = histories[-1]
    objectives, violations = (
        np.concatenate([getattr(one, name) for one in histories]) for name in ("objectives", "violations")
    )
    return Searched(last.method, objectives, violations, last.end, sum(one.seconds for one in histories))
