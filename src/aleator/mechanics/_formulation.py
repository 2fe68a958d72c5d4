"""What forward, inverse and hybrid dynamics are: systems that a mechanical model moves in."""

from typing import Any

import equinox as eqx

from aleator._core.given import one_of
from aleator._core.leaves import transparent
from aleator.dynamics import System
from aleator.mechanics._mechanical import AbstractMechanical


@transparent("model")
class AbstractFormulation(System):
    """A system that solves the equations of motion of a mechanical model for what is not given.

    The model's numbers go by their own names in it.
    """

    model: eqx.AbstractVar[AbstractMechanical]


def model_given(who: str, model: Any) -> AbstractMechanical:
    """The model of a formulation as it is. Raises `ProblemError` for what is no mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")
