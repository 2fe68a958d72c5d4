"""`AbstractBox`: a function that evaluates many realisations in one call, in its own way, and may fail at some."""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

from aleator._core.arrays import Pytree
from aleator.ensemble._outputs import listed


class Realisation(NamedTuple):
    """A model with plain numbers: the number of its sample, from 1 on, and the values of its uncertain inputs."""

    number: int
    model: Pytree
    inputs: dict[str, float]

    def __str__(self) -> str:
        return f"sample {self.number} ({listed(self.inputs)})"


class AbstractBox(abc.ABC):
    """A function of a realised model that is never traced, and is asked for many realisations at once."""

    @abc.abstractmethod
    def __call__(self, realised: Pytree) -> Pytree:
        """The outputs at one realisation."""

    @abc.abstractmethod
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        """The outputs at each realisation as finite NumPy arrays of the same shapes; None where a sample is left out.

        `whole`: no sample may be left out, because the method needs all of them.
        """

    @property
    def follows_from(self) -> Any:
        """All that its outputs follow from besides the model, for a journal; None if its results are not kept there."""
        return None
