"""Germs outside the Askey scheme: triangular, truncated normal, Weibull, Gumbel, any density, and a data sample."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.uncertainty._polynomials import AbstractGerm
from aleator.uncertainty._stieltjes import AbstractDensityGerm, recurrence_of


@final
@dataclass(frozen=True)
class TriangularGerm(AbstractDensityGerm):
    """Triangular on [-1, 1]; `mode` is the peak's position as a fraction of the interval, from 0 at -1 to 1 at 1."""

    mode: float

    @override
    def density(self, germ: np.ndarray) -> np.ndarray:
        rise, fall = self.mode or 1.0, 1 - self.mode or 1.0  # a side of length 0 has no points
        return np.where(germ < 2 * self.mode - 1, (1 + germ) / rise, (1 - germ) / fall)

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        level = np.asarray(level, dtype=float)
        rising, falling = 2 * np.sqrt(self.mode * level) - 1, 1 - 2 * np.sqrt((1 - self.mode) * (1 - level))
        return np.where(level < self.mode, rising, falling)

    @override
    def support(self) -> tuple[float, float]:
        return -1.0, 1.0


@final
@dataclass(frozen=True)
class TruncatedNormalGerm(AbstractDensityGerm):
    """Standard normal, truncated to [`low`, `high`], of which either may be infinite."""

    low: float
    high: float

    @override
    def density(self, germ: np.ndarray) -> np.ndarray:
        """Equal to 1 at the peak, however far in the tail the interval lies."""
        peak = np.clip(0.0, self.low, self.high)
        return np.exp(-(germ - peak) * (germ + peak) / 2)

    @override
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@final
@dataclass(frozen=True)
class WeibullGerm(AbstractDensityGerm):
    """Weibull on [0, inf) with unit scale: density proportional to `xi^(shape - 1) exp(-xi^shape)`."""

    shape: float

    @override
    def density(self, germ: np.ndarray) -> np.ndarray:
        return np.exp((self.shape - 1) * np.log(germ) - germ**self.shape)

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return (-np.log1p(-np.asarray(level))) ** (1 / self.shape)

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        return -np.expm1(-(np.maximum(germ, 0) ** self.shape))

    @override
    def support(self) -> tuple[float, float]:
        return 0.0, np.inf


@final
@dataclass(frozen=True)
class GumbelGerm(AbstractDensityGerm):
    """Standard Gumbel distribution of maxima: `F(xi) = exp(-exp(-xi))`."""

    @override
    def density(self, germ: np.ndarray) -> np.ndarray:
        return np.exp(-germ - np.exp(-germ))

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return -np.log(-np.log(level))

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            return np.exp(-np.exp(-np.asarray(germ)))

    @override
    def support(self) -> tuple[float, float]:
        return -np.inf, np.inf


@final
@dataclass(frozen=True)
class DensityGerm(AbstractDensityGerm):
    """Any density on (low, high), not necessarily normalised, as a NumPy function of an array of points."""

    function: Callable[[np.ndarray], np.ndarray]
    low: float
    high: float

    @override
    def density(self, germ: np.ndarray) -> np.ndarray:
        return self.function(germ)

    @override
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@final
class SampleGerm(AbstractGerm):
    """The measure of a data sample: polynomials orthonormal under the data (arbitrary polynomial chaos).

    Source: Oladyshkin and Nowak, Reliability Engineering & System Safety 106 (2012). A sample of n distinct values
    carries polynomials up to order n - 1. The quantile is the value at which the empirical distribution function
    reaches a level; it is a step function, so that drawn values have the moments of the data. `levels` are the levels
    at which it steps from one value to the next.
    """

    def __init__(self, data: Float[np.ndarray, " n"]):
        self.values, counts = np.unique(data, return_counts=True)
        self.weights = counts / counts.sum()
        self.levels = np.cumsum(counts)[:-1] / counts.sum()
        # The data are static when a model is compiled, so two germs are equal if their values are.
        self._digest = hashlib.sha256(self.values.tobytes() + counts.tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        """Whether the other germ holds the same data."""
        return isinstance(other, SampleGerm) and self._digest == other._digest

    def __hash__(self) -> int:
        """Hash of the data."""
        return hash(self._digest)

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Raises `ProblemError` if the order is too high for the data."""
        if order >= self.values.size:
            raise ProblemError(
                f"A sample of {self.values.size} distinct values carries polynomials up to order "
                f"{self.values.size - 1}; received order {order}. Lower the order, or give more data."
            )
        a, b, _ = recurrence_of(self.values, self.weights, order)
        return a, b

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return self.values[np.searchsorted(self.levels, level, side="left")]

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        """At one of the data itself, half of its probability counts as below."""
        reached = np.concatenate([[0.0], self.levels, [1.0]])
        below, up_to = (reached[np.searchsorted(self.values, germ, side=side)] for side in ("left", "right"))
        return (below + up_to) / 2

    @override
    def support(self) -> tuple[float, float]:
        return float(self.values[0]), float(self.values[-1])
