"""`MultipleShooting`: states are variables at nodes alone, and integrated from each to the next.

(Bock and Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC 1984.)
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.border import refusal, whole
from aleator.dynamics._mean_rates import AbstractMeanRate, SegmentRate
from aleator.dynamics._schemes import AbstractScheme

_MOST_STEPS = 100


@final
@dataclass(frozen=True)
class MultipleShooting(AbstractScheme):
    """Segments that are integrated by some equal steps of `al.integrators.RungeKutta4`, of order 4: for models that a
    mesh of states would make too large, and whose segments can be simulated. Algebraic variables are solved for on the
    way.

    Raises `ProblemError` unless there are between 1 and 100 steps: second derivatives of a segment are dense in the
    signals of all of its steps, so that more segments take less memory than more steps.
    """

    steps: int = 4

    def __post_init__(self) -> None:
        if whole("MultipleShooting: steps", self.steps) > _MOST_STEPS:
            expected = f"at most {_MOST_STEPS} steps in a segment (take more segments: a grid of more steps)"
            raise refusal("MultipleShooting: steps", expected, self.steps)

    @override
    def __str__(self) -> str:
        return f"MultipleShooting({self.steps})"

    @property
    @override
    def order(self) -> int:
        return 4

    @property
    @override
    def rate(self) -> AbstractMeanRate:
        return self._segment

    @property
    @override
    def has_algebraic_variables(self) -> bool:
        return False

    @property
    @override
    def points(self) -> Float[np.ndarray, " points"]:
        return np.array([0.0, 1.0])

    @property
    @override
    def told(self) -> Float[np.ndarray, " told"]:
        return self._segment.told

    @property
    @override
    def asked(self) -> slice:
        return slice(0, 1)

    @property
    @override
    def seen(self) -> Int[np.ndarray, "blocks seen"]:
        return np.arange(len(self.told))[None]

    @property
    @override
    def weights(self) -> Float[np.ndarray, "later blocks"]:
        return np.ones((1, 1))

    @property
    @override
    def quadrature(self) -> Float[np.ndarray, " told"]:
        return self._segment.quadrature

    @property
    @override
    def estimated_order(self) -> int:
        return self.order

    @property
    def _segment(self) -> SegmentRate:
        return SegmentRate(self.steps)
