"""`Effort`: iterations, evaluations and times of a solve."""

from dataclasses import dataclass
from typing import final

from aleator._core.shown import Printed
from aleator.nlp import Searched, Status


@final
@dataclass(frozen=True)
class Times(Printed):
    """Wall times in seconds. `compile_` is zero if a problem of the same structure was compiled before."""

    import_: float
    compile_: float
    solve: float

    def __str__(self) -> str:
        return f"import {self.import_:.2f} s, compile {self.compile_:.2f} s, solve {self.solve:.3f} s"


@final
@dataclass(frozen=True)
class AtMeans(Printed):
    """The deterministic problem where that was solved first.

    - `status`: how it ended; `starts`: whether the problem itself was started from there;
    - `iterations`, `evaluations`: see `Effort`.
    """

    status: Status
    starts: bool
    iterations: int
    evaluations: int

    def __str__(self) -> str:
        end = "" if self.starts else f", which ended as '{self.status.value}' and started nothing"
        return f"{self.iterations} iterations, {self.evaluations} evaluations for the deterministic problem{end}"


@final
@dataclass(frozen=True)
class Effort(Printed):
    """Iterations, evaluations and times of a solve.

    - `solver`: its name and version; `iterations`: as the solver counts them, over all restarts;
    - `evaluations`: points at which the problem was simulated; `times`: wall times;
    - `at_means`: the deterministic problem, if that was solved first; its work is not counted in the others, except for
      compilations;
    - `searched`: the history of a search without derivatives, if there was one; its evaluations are counted;
    - `visited`: the history of the local solver (`al.reporting.search_figure` draws it), if there was one.
    """

    solver: str
    iterations: int
    evaluations: int
    times: Times
    at_means: AtMeans | None = None
    searched: Searched | None = None
    visited: Searched | None = None

    def __str__(self) -> str:
        before = "" if self.at_means is None else f"after {self.at_means}: "
        before += "" if self.searched is None else f"{self.searched}; in all "
        return f"{before}{self.iterations} iterations, {self.evaluations} evaluations; {self.times}"
