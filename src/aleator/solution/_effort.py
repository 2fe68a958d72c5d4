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
        return (
            f"{self.iterations} iterations, {self.evaluations} evaluations; import {self.times.import_:.2f} s, "
            f"compile {self.times.compile_:.2f} s, solve {self.times.solve:.3f} s"
        )
