"""Mean rates: what a block of a scheme says of the states at the end of an interval, `x_1 = x_0 + h Σ_j w_j r_j`.

A collocation scheme's `r_j` are rates at points. A one-step method's is its increment function: the mean rate over the
whole interval (Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I, II.3).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator.dynamics._integrators import RungeKutta4

Rate: TypeAlias = Callable[[Array, Array, Array], Float[Array, " rates"]]
"""The rates of states, then integrands, at a place in time, with the signals and the states there."""

_RULE = RungeKutta4.tableau
# Each stage of this rule depends on the one before alone, and signals are told twice a step.
_COUPLINGS = np.array([row[-1] if row else 0.0 for row in _RULE.couplings])
_WEIGHTS, _TWICE = np.array(_RULE.weights), 2 * np.array(_RULE.nodes)


class AbstractMeanRate(abc.ABC):
    """What one block of a scheme is: a mean of rates, from the states where it begins."""

    @property
    @abc.abstractmethod
    def steps(self) -> int:
        """Steps in time that an interval of a mesh stands for."""

    @abc.abstractmethod
    def __call__(
        self,
        rate: Rate,
        places: Float[Array, "told 2"],
        signals: Float[Array, "told signals"],
        states: Float[Array, " states"],
    ) -> Float[Array, " rates"]:
        """The mean.

        - `places`: where signals are told; the first number of each is the time; `states`: at the first of them.
        """


@final
@dataclass(frozen=True)
class PointRate(AbstractMeanRate):
    """The rate at one point."""

    @property
    @override
    def steps(self) -> int:
        return 1

    @override
    def __call__(
        self,
        rate: Rate,
        places: Float[Array, "told 2"],
        signals: Float[Array, "told signals"],
        states: Float[Array, " states"],
    ) -> Float[Array, " rates"]:
        return rate(places[0], signals[0], states)


@final
@dataclass(frozen=True)
class SegmentRate(AbstractMeanRate):
    """The mean over a segment of time, by some equal steps of `RungeKutta4`.

    Signals are told at the ends and in the middle of each step.
    """

    count: int

    @property
    @override
    def steps(self) -> int:
        return self.count

    @property
    def told(self) -> Float[np.ndarray, " told"]:
        """Where signals are told, as fractions of the segment."""
        return np.linspace(0.0, 1.0, 2 * self.count + 1)

    @property
    def quadrature(self) -> Float[np.ndarray, " told"]:
        """The weights of what is told in a mean over the segment."""
        found = np.zeros(len(self.told))
        np.add.at(found, self._places, np.tile(_WEIGHTS, self.count) / self.count)
        return found

    @override
    def __call__(
        self,
        rate: Rate,
        places: Float[Array, "told 2"],
        signals: Float[Array, "told signals"],
        states: Float[Array, " states"],
    ) -> Float[Array, " rates"]:
        h = (places[-1, 0] - places[0, 0]) / self.count
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
        every = (*(jnp.asarray(np.tile(one, self.count)) for one in each), places[self._places], signals[self._places])
        # A loop over stages, not steps: a model is traced once, however many there are.
        (_, moved, _), _ = jax.lax.scan(stage, (zeros, zeros, zeros), every)
        return moved / self.count

    @property
    def _places(self) -> np.ndarray:
        """Which of the places each stage of each step is at."""
        return (2 * np.arange(self.count)[:, None] + _TWICE.astype(int)).ravel()
