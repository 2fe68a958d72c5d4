"""A germ variable inside one element: its distribution conditional on an interval."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator.uncertainty import AbstractGerm, LegendreGerm
from aleator.uncertainty._families import tanh_sinh
from aleator.uncertainty._measure import recurrence_of


def restricted(germ: AbstractGerm, low: float, high: float) -> AbstractGerm:
    """The distribution of `germ` given that its probability level lies between `low` and `high`."""
    return germ if (low, high) == (0.0, 1.0) else RestrictedGerm(germ, low, high)


# Probability levels that cluster at both ends of an element, with their weights.
_LEVELS, _WEIGHTS = tanh_sinh(240, -4.0, 4.0)


@final
@dataclass(frozen=True)
class RestrictedGerm(AbstractGerm):
    """The distribution of `germ` given that its probability level lies between `low` and `high`.

    Its values are those of `germ` itself. A restricted uniform distribution is uniform. The polynomials of any other
    follow by Stieltjes' procedure from quadrature over the levels (Wan and Karniadakis, 2006, Multi-element generalized
    polynomial chaos for arbitrary probability measures).
    """

    germ: AbstractGerm
    low: float
    high: float

    @override
    def recurrence(self, order: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        if isinstance(self.germ, LegendreGerm):
            a, b = self.germ.recurrence(order)
            return a + (self.low + self.high - 1), b * (self.high - self.low)
        a, b, _ = recurrence_of(*self._quadrature(), order)
        return a, b

    @override
    def quantile(self, level: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return self.germ.quantile(self.low + level * (self.high - self.low))

    @override
    def cumulative(self, germ: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.clip((self.germ.cumulative(germ) - self.low) / (self.high - self.low), 0.0, 1.0)

    @override
    def support(self) -> tuple[float, float]:
        first, last = self.germ.support()
        low = first if self.low == 0 else float(self.germ.quantile(np.array(self.low)))
        high = last if self.high == 1 else float(self.germ.quantile(np.array(self.high)))
        return low, high

    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Germ values and probability weights. The nodes cluster at an end of an unbounded distribution."""
        levels = self.low + _LEVELS * (self.high - self.low)
        inside = (levels > 0) & (levels < 1)
        return self.germ.quantile(levels[inside]), _WEIGHTS[inside] / _WEIGHTS[inside].sum()
