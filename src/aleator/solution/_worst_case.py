"""The worst realisations of a solution: which systems come closest to its limits on the worst case."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.solution._systems import system_text


@final
@dataclass(frozen=True)
class WorstRealisation(Printed):
    """The system that comes closest to a limit on the worst case, or breaks it most.

    - `name`, `text`: of the constraint; `value`: of its functional; `beyond`: the excess over the bound, negative
      inside; `time`: when (s), None if it is no limit over time;
    - `numbers`: the uncertain numbers of that system, by name.
    """

    name: str
    text: str
    value: float
    beyond: float
    time: float | None
    numbers: Mapping[str, float]

    @property
    def system(self) -> str:
        """The system by its uncertain numbers, the first few if there are many."""
        return system_text(self.numbers)

    def sentence(self) -> str:
        """The value, when it is reached, and by which system."""
        when = "" if self.time is None else f" at t = {self.time:.4g} s"
        return f"{self.name} reaches {self.value:.6g}{when} with {self.system}"

    def __str__(self) -> str:
        return self.sentence()


@final
@dataclass(frozen=True)
class WorstCase(Printed):
    """The worst cases of a solution, found by a search over realisations of the model; the search is no proof.

    - `realisations`: the worst of each limit on the worst case, in the order of the constraints;
    - `scenarios`: the germ points at which the program imposed the limits, shape (scenarios, variables);
    - `rounds`: how often the program was solved, with more scenarios each time;
    - `searched`: the number of realisations that were simulated.
    """

    realisations: tuple[WorstRealisation, ...]
    scenarios: Float[np.ndarray, "scenarios variables"]
    rounds: int
    searched: int

    def of(self, text: str) -> WorstRealisation | None:
        """The worst realisation of the constraint with this text; None if it is no limit on the worst case."""
        return next((one for one in self.realisations if one.text == text), None)

    def broken(self) -> str:
        """The realisation that breaks its limit most, with the remedy if the search did not converge."""
        worst = max(self.realisations, key=lambda one: one.beyond)
        return (
            f"After {self.rounds} rounds {worst.sentence()}, {worst.beyond:.3g} beyond its bound: each new design "
            "breaks it at another realisation. Narrow the distributions, or give the optimiser fewer decisions."
        )

    def rows(self) -> list[str]:
        """A line for each limit, then how they were found."""
        found = [one.sentence() for one in self.realisations]
        return [*found, f"the worst of {self.searched} realisations of the model, in {self.rounds} rounds"]

    def __str__(self) -> str:
        return "\n".join(self.rows())
