"""The base class of forward, inverse and hybrid dynamics: systems made from a mechanical model."""

from typing import Any

import equinox as eqx

from aleator._core.given import one_of
from aleator._core.leaves import transparent
from aleator.dynamics import System
from aleator.mechanics._mechanical import AbstractMechanical


@transparent("model")
class AbstractFormulation(System):
    """A system that solves the equations of motion of a mechanical model for the unknown motions and torques.

    The model's numbers keep their own names, without the prefix `model`.
    """

    model: eqx.AbstractVar[AbstractMechanical]


def model_given(who: str, model: Any) -> AbstractMechanical:
    """The model, unchanged. Raises `ProblemError` for anything but a mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")
