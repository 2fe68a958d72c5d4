"""`AbstractSystem`: what all kinds of systems are asked, whether they move in time or not."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx


class AbstractSystem(eqx.Module):
    """What can be simulated: a `System`, which moves in time, or an `AlgebraicSystem`, which has none.

    - `has_time`: whether it moves in time; `units`: those of its outputs as far as they are known, for reports.
    """

    has_time: ClassVar[bool]
    units: ClassVar[Mapping[str, str]] = {}

    @property
    @abc.abstractmethod
    def is_integrated(self) -> bool:
        """Whether it has states, which are integrated over time."""

    @abc.abstractmethod
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Quantities of interest by name: accelerations, distances, forces."""

    def diagnose(self, grid: Any) -> str:
        """What is wrong with the realised system on a grid, in a sentence with its remedy; empty if nothing.

        It is asked before anything is compiled.
        """
        del grid
        return ""

    def holding(self, grid: Any) -> Mapping[str, Any]:
        """What it takes to stay at the start, by the names of outputs such as torques, where it is made to rest there.

        None by default, nor where it starts on the move or may begin to move.
        """
        del grid
        return {}
