"""`MultipleShooting`: states are variables at nodes alone, and integrated from each to the next.

(Bock and Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC 1984.)
"""

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from typing_extensions import override

from aleator._core.border import refusal, whole
from aleator.dynamics._schemes import AbstractMeanRate, AbstractScheme, Rate
from aleator.dynamics._tableaux import RUNGE_KUTTA_4

_MOST_STEPS = 100
_RULE = RUNGE_KUTTA_4

# Each stage of this rule depends on the one before alone, and signals are told twice a step.
_COUPLINGS = np.array([row[-1] if row else 0.0 for row in _RULE.couplings])
_WEIGHTS, _TWICE = np.array(_RULE.weights), 2 * np.array(_RULE.nodes)


@final
@dataclass(frozen=True)
class SegmentRate(AbstractMeanRate):
    """The mean over a segment of time, by some equal steps of `RungeKutta4`.

    Signals are told at the ends and in the middle of each step.
    """

    steps: int

    @property
    def told(self) -> Float[np.ndarray, " told"]:
        """Where signals are told, as fractions of the segment."""
        return np.linspace(0.0, 1.0, 2 * self.steps + 1)

    @property
    def quadrature(self) -> Float[np.ndarray, " told"]:
        """The weights of what is told in a mean over the segment."""
        weights = np.zeros(len(self.told))
        np.add.at(weights, self._places, np.tile(_WEIGHTS, self.steps) / self.steps)
        return weights

    @override
    def __call__(
        self,
        rate: Rate,
        places: Float[Array, "told 2"],
        signals: Float[Array, "told signals"],
        states: Float[Array, " states"],
    ) -> Float[Array, " rates"]:
        h = (places[-1, 0] - places[0, 0]) / self.steps
        zeros = jnp.zeros(jax.eval_shape(rate, places[0], signals[0], states).shape)

        def stage(
            carried: tuple[Array, Array, Array], now: tuple[Array, ...]
        ) -> tuple[tuple[Array, Array, Array], None]:
            """One of all stages: of what was moved when its step began, until now, and by the stage before."""
            (begun, moved, slope), (begins, coupling, weight, place, signal) = carried, now
            begun = jnp.where(begins, moved, begun)
            slope = rate(place, signal, states + h * (begun + coupling * slope)[: states.size])
            return (begun, moved + weight * slope, slope), None

        each = (np.arange(len(_WEIGHTS)) == 0, _COUPLINGS, _WEIGHTS)
        every = (*(jnp.asarray(np.tile(one, self.steps)) for one in each), places[self._places], signals[self._places])
        # A loop over stages, not steps: a model is traced once, however many there are.
        (_, moved, _), _ = jax.lax.scan(stage, (zeros, zeros, zeros), every)
        return moved / self.steps

    @property
    def _places(self) -> np.ndarray:
        """Which of the places each stage of each step is at."""
        return (2 * np.arange(self.steps)[:, None] + _TWICE.astype(int)).ravel()


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
