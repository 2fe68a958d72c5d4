"""`GridError`: how far a solution differs from that on a finer grid with an integrator of another order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

_MANY = 100  # factor of steps beyond which no number is given: an unstable integration does not converge with order 4
_AHEAD = 1.2  # safety factor on the number of steps that fourth order predicts


@final
@dataclass(frozen=True)
class Deviation:
    """How far a quantity differs from its value on a finer grid, in its own unit.

    - `error`: for a functional the largest change of its mean or its standard deviation, plus a quarter for the error
      of the finer grid itself; `tolerated`: the error that is accepted;
    - `time`: when a path differs most (s); NaN for other functionals.
    """

    error: float
    tolerated: float
    time: float = float("nan")

    @property
    def ratio(self) -> float:
        """The error over the tolerated error; infinite if the error is NaN."""
        return np.inf if np.isnan(self.error) else self.error / self.tolerated


@final
@dataclass(frozen=True)
class GridError:
    """The error of the time grid at a solution, estimated by a finer grid and an integrator of another order.

    - `steps`: of the solution's grid; `factor`: how many times as many the finer one has; `integrator`: the other one;
    - `accuracy`: the tolerated error, relative to a limit or a spread, whichever is smaller;
    - `objective`: its deviation; the tolerated error is `accuracy` times its magnitude;
    - `functionals`: deviations by the texts of the functionals;
    - `broken`: a sentence on the constraint that does not hold on the finer grid; empty if all hold;
    - `at_start`: a sentence on large errors of the grid at the initial design, which may have misled the search; empty
      if there are none, or if that was not checked.
    """

    steps: int
    factor: int
    integrator: str
    accuracy: float
    objective: Deviation
    functionals: Mapping[str, Deviation]
    broken: str = ""
    at_start: str = ""

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
        return self.ratio <= 1 and not self.broken and not self.at_start

    @property
    def is_usable(self) -> bool:
        """Whether the solution holds on the finer grid: all limits, the objective to tolerance, and no NaN."""
        finite = all(np.isfinite(one.error) for one in self.functionals.values())
        return self.objective.ratio <= 1 and not self.broken and finite

    @property
    def steps_needed(self) -> int:
        """How many steps meet the tolerance, if the error falls with the fourth power of the step."""
        ratio = self.ratio if np.isfinite(self.ratio) else 1e4
        least = 1.0 if self.is_met else 2.0
        return int(np.ceil(self.steps * max(least, _AHEAD * ratio**0.25)))

    def sentence(self) -> str:
        """What deviates most, by how much, and how much would be tolerated."""
        if self.broken:
            return self.broken
        if self.at_start and self.ratio <= 1:
            return self.at_start
        if self.objective.ratio > 1 or not self.functionals:
            what, one = "the objective", self.objective
        else:
            what, one = f"'{self.worst}'", self.functionals[self.worst]
        when = "" if np.isnan(one.time) else f" at t = {one.time:.4g} s"
        return f"{what} is off by {one.error:.2g}{when}, where {one.tolerated:.2g} is tolerated"

    def __str__(self) -> str:
        where = f"seen on {self.factor} times as many steps"
        if self.is_met:
            return f"objective off by {self.objective.error:.1e}, {self._worst_text()}; {where}"
        many = self.steps_needed > _MANY * self.steps
        steps = "many more" if many else f"about {self.steps_needed}"
        return f"{self.sentence()}; {where}: use {steps} steps, or refine=True"

    def _worst_text(self) -> str:
        if not self.worst:
            return "nothing else"
        return f"'{self.worst}' by {self.functionals[self.worst].error:.1e}"
