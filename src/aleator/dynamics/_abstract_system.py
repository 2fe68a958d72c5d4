"""`AbstractSystem`: the interface of all systems, dynamical or algebraic."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

from aleator._core.leaves import Module, Printed


class AbstractSystem(Module, Printed):
    """What can be simulated: a `System`, which evolves in time, or an `AlgebraicSystem`, which has no time.

    - `has_time`: whether it evolves in time; `units`: the units of its outputs as far as they are known, for reports.
    """

    has_time: ClassVar[bool]
    units: ClassVar[Mapping[str, str]] = {}

    @property
    def title(self) -> str:
        """The name of its class, for messages."""
        return type(self).__name__

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
        """The holding torques: the outputs that keep the system at rest at its start, by name.

        Empty by default, and where the system does not start at rest or is free to move.
        """
        del grid
        return {}
