"""`GridError`: how far a solution differs from that on a finer grid with an integrator of another order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.shown import Printed

# Limits on the factor of steps from one grid to the next, since the error of a very coarse grid predicts no number of
# steps; and the safety factor on the number that the order of convergence predicts.
_LEAST, _MOST, _AHEAD = 2, 8, 1.2


@final
@dataclass(frozen=True)
class Deviation(Printed):
    """How far a quantity differs from its value on a finer grid, in its own unit.

    - `error`: for a functional the largest change of its mean or its standard deviation, plus a quarter for the error
      of the finer grid itself; `tolerated`: the error that is accepted;
    - `time`: when a path differs most (s); NaN for other functionals;
    - `order`: the order of convergence: by which power of the step the error falls.
    """

    error: float
    tolerated: float
    time: float = float("nan")
    order: int = 4

    @property
    def ratio(self) -> float:
        """The error over the tolerated error; infinite if the error is NaN."""
        return np.inf if np.isnan(self.error) else self.error / self.tolerated

    @property
    def finer(self) -> float:
        """The factor of steps that meets the tolerance, by the order of convergence."""
        return self.ratio ** (1 / self.order)

    def __str__(self) -> str:
        when = "" if np.isnan(self.time) else f" at t = {self.time:.4g} s"
        return f"off by {self.error:.2g}{when}, where {self.tolerated:.2g} is tolerated"


@final
@dataclass(frozen=True)
class GridError(Printed):
    """The error of the time grid at a solution, estimated by a finer grid and an integrator of another order.

    - `steps`: of the solution's grid; `factor`: how many times as many the finer one has; `integrator`: the other one;
    - `accuracy`: the tolerated error, relative to a limit or a spread, whichever is smaller;
    - `objective`: its deviation; the tolerated error is `accuracy` times its magnitude;
    - `functionals`: deviations by the texts of the functionals;
    - `broken`: a sentence on the constraint that does not hold on the finer grid; empty if all hold;
    - `unresolved`: a sentence on the constraint that differs so much on the finer grid, or at other instants, that this
      grid does not tell whether it holds, though it does there; empty if there is none;
    - `at_start`: a sentence on large errors of the grid at the initial design, which may have misled the search; empty
      if there are none, or if that was not checked;
    - `pieces`: the number of polynomial pieces of the splines that the system follows, whose ends should be instants;
    - `by_tolerances`: whether the integrator has tolerances of its own, besides the steps of the grid.
    """

    steps: int
    factor: int
    integrator: str
    accuracy: float
    objective: Deviation
    functionals: Mapping[str, Deviation]
    broken: str = ""
    unresolved: str = ""
    at_start: str = ""
    pieces: int = 1
    by_tolerances: bool = False

    @property
    def worst(self) -> str:
        """The text of the functional with the largest deviation over its tolerance; empty if there is none."""
        return max(self.functionals, key=lambda text: self.functionals[text].ratio, default="")

    @property
    def ratio(self) -> float:
        """The largest deviation of a functional or of the objective over its tolerance."""
        return max([self.objective.ratio, *(one.ratio for one in self.functionals.values())])

    @property
    def is_met(self) -> bool:
        """Whether all deviations are tolerated."""
        return self.ratio <= 1 and not self.broken and not self.unresolved and not self.at_start

    @property
    def is_usable(self) -> bool:
        """Whether the solution holds on the finer grid: all limits, the objective to tolerance, and no NaN; and whether
        this grid resolves the limits.
        """
        finite = all(np.isfinite(one.error) for one in self.functionals.values())
        return self.objective.ratio <= 1 and not self.broken and not self.unresolved and finite

    @property
    def steps_needed(self) -> int:
        """The number of steps of the next grid, which `solve(refine=True)` takes.

        It meets the tolerance by the orders of convergence, but is at most eight times the present number.
        """
        if self.is_met:
            return self.steps
        return self.with_whole_pieces(min(max(_LEAST, self._finer), _MOST) * self.steps)

    def with_whole_pieces(self, steps: float) -> int:
        """The least number of steps from `steps` on that ends one at each end of a spline's pieces: no order is lost
        there.
        """
        return self.pieces * int(np.ceil(steps / self.pieces))

    @property
    def _finer(self) -> float:
        return _AHEAD * max([self.objective.finer, *(one.finer for one in self.functionals.values())])

    def sentence(self) -> str:
        """What deviates most, by how much, and how much would be tolerated."""
        if self.broken or self.unresolved:
            return self.broken or self.unresolved
        if self.at_start and self.ratio <= 1:
            return self.at_start
        if self.objective.ratio > 1 or not self.functionals:
            what, one = "the objective", self.objective
        else:
            what, one = f"'{self.worst}'", self.functionals[self.worst]
        return f"{what} is {one}"

    def __str__(self) -> str:
        where = f"seen on {self.factor} times as many steps"
        if self.is_met:
            return f"objective off by {self.objective.error:.1e}, {self._worst_text()}; {where}"
        told = "about" if self.ratio > 1 and self._finer <= _MOST else "at least"
        also = " and smaller tolerances of the integrator" if self.by_tolerances else ""
        return f"{self.sentence()}; {where}: use {told} {self.steps_needed} steps{also}, or refine=True"

    def _worst_text(self) -> str:
        if not self.worst:
            return "nothing else"
        return f"'{self.worst}' by {self.functionals[self.worst].error:.1e}"
