"""`Effort`: iterations, evaluations and times of a solve."""

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Times:
    """Wall times in seconds. `compile_` is zero if a problem of the same structure was compiled before."""

    import_: float
    compile_: float
    solve: float

    def __str__(self) -> str:
        return f"import {self.import_:.2f} s, compile {self.compile_:.2f} s, solve {self.solve:.3f} s"


@final
@dataclass(frozen=True)
class Effort:
    """Iterations, evaluations and times of a solve.

    - `solver`: its name and version; `iterations`: as the solver counts them, over all restarts;
    - `evaluations`: points at which the problem was simulated; `times`: wall times.
    """

    solver: str
    iterations: int
    evaluations: int
    times: Times

    def __str__(self) -> str:
        return f"{self.iterations} iterations, {self.evaluations} evaluations; {self.times}"
