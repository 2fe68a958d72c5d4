"""`GridError`: how far a solution would differ on a finer grid, by an integrator of another order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

_MANY = 100  # times as many steps: what an unstable integration is off by says nothing of how many it takes
_AHEAD = 1.2  # more steps than an error of fourth order asks for


@final
@dataclass(frozen=True)
class Deviation:
    """How far something differs from what a finer grid gives, in its own unit.

    - `error`: of a functional the largest change of its mean or its standard deviation; with a quarter on top for what
      the finer grid errs itself; `tolerated`: how much may pass;
    - `time`: when a path differs most, s; not a number for others.
    """

    error: float
    tolerated: float
    time: float = float("nan")

    @property
    def ratio(self) -> float:
        """The error over what is tolerated; a number that is none is beyond all."""
        return np.inf if np.isnan(self.error) else self.error / self.tolerated


@final
@dataclass(frozen=True)
class GridError:
    """The error of the time grid at a solution, seen by a finer grid and an integrator of another order.

    - `steps`: of the solution's grid; `factor`: how many times as many the other has; `integrator`: that of the other;
    - `accuracy`: the part of a limit or of a spread, whichever is smaller, that is tolerated;
    - `objective`: its deviation, of which `accuracy` of its own magnitude is tolerated;
    - `functionals`: by their texts;
    - `broken`: a sentence on the constraint that does not hold on the finer grid; empty if all do;
    - `at_start`: a sentence on what the grid is far off at the design that the search began with, so that it may have
      been led astray; empty where it is not, or where that was not looked at.
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
        """The text of the functional that deviates most beside what is tolerated; empty if there is none."""
        return max(self.functionals, key=lambda text: self.functionals[text].ratio, default="")

    @property
    def ratio(self) -> float:
        """The largest deviation of a functional or of the objective over what is tolerated."""
        return max([self.objective.ratio, *(one.ratio for one in self.functionals.values())])

    @property
    def is_met(self) -> bool:
        """Whether all deviations are tolerated."""
        return self.ratio <= 1 and not self.broken and not self.at_start

    @property
    def is_usable(self) -> bool:
        """Whether the solution stands on the finer grid too: no limit breaks there, it costs what it says, and nothing
        is not a number.
        """
        finite = all(np.isfinite(one.error) for one in self.functionals.values())
        return self.objective.ratio <= 1 and not self.broken and finite

    @property
    def steps_needed(self) -> int:
        """How many steps bring the error down to what is tolerated, if it falls with the fourth power of a step."""
        ratio = self.ratio if np.isfinite(self.ratio) else 1e4
        least = 1.0 if self.is_met else 2.0
        return int(np.ceil(self.steps * max(least, _AHEAD * ratio**0.25)))

    def sentence(self) -> str:
        """What deviates most, by how much, and how much is tolerated."""
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
