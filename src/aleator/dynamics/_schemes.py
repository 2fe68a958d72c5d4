"""Collocation schemes for simultaneous transcription: how states follow from their rates between nodes.

Over each interval of a mesh the states are polynomials whose rates agree with the dynamics at the scheme's stages.
Schemes differ only in the positions of their stages (Hairer, Nørsett and Wanner, Solving Ordinary Differential
Equations I, II.7; Betts, Practical Methods for Optimal Control, chapter 4).
"""

import abc
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from jaxtyping import Float
from numpy.polynomial import legendre
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.given import whole

# With more stages the points lose accuracy in 64-bit arithmetic, without any gain.
_MOST_STAGES = 12


@dataclass(frozen=True)
class AbstractScheme(abc.ABC):
    """A collocation scheme, determined by its stages."""

    @property
    @abc.abstractmethod
    def nodes(self) -> Float[np.ndarray, " stages"]:
        """The stages: points where rates agree with the dynamics, as increasing fractions of an interval."""

    @property
    @abc.abstractmethod
    def order(self) -> int:
        """The order of convergence of the states at the nodes in the interval's length."""

    def __str__(self) -> str:
        return type(self).__name__

    @cached_property
    def points(self) -> Float[np.ndarray, " points"]:
        """The points where states are variables: the stages and both ends of the interval."""
        inner = [node for node in self.nodes if 0 < node < 1]
        return np.array([0.0, *inner, 1.0])

    @cached_property
    def asked(self) -> slice:
        """The slice of the stages among the points."""
        return slice(0 if self.nodes[0] == 0 else 1, None if self.nodes[-1] == 1 else -1)

    @cached_property
    def weights(self) -> Float[np.ndarray, "later stages"]:
        """The integral of the rates' interpolant from the interval's start to each later point, for a unit interval.

        The last row is the scheme's quadrature.
        """
        return self.integrals(self.points[1:])

    def integrals(self, at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n stages"]:
        """The integral of the rates' interpolant from the interval's start to other points, for a unit interval."""
        count = len(self.nodes)
        ends = legendre.legvander(2 * np.asarray(at) - 1, count)
        start = legendre.legvander(np.array([-1.0]), count)
        integrals = np.stack([_integral(ends, j) - _integral(start, j) for j in range(count)], axis=1)
        return integrals @ self._interpolation / 2

    def interpolated(self, at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n stages"]:
        """The rates' interpolant at other points of the interval, from the rates at the stages."""
        return legendre.legvander(2 * np.asarray(at) - 1, len(self.nodes) - 1) @ self._interpolation

    @cached_property
    def _interpolation(self) -> Float[np.ndarray, "degrees stages"]:
        """From the rates at the stages to their coefficients in Legendre polynomials."""
        return np.linalg.inv(legendre.legvander(2 * self.nodes - 1, len(self.nodes) - 1))


def _integral(values: Float[np.ndarray, "points degrees"], degree: int) -> Float[np.ndarray, " points"]:
    """An integral of a Legendre polynomial, from the values of all polynomials up to one degree more."""
    return values[:, 1] if degree == 0 else (values[:, degree + 1] - values[:, degree - 1]) / (2 * degree + 1)


@final
@dataclass(frozen=True)
class Trapezoid(AbstractScheme):
    """The trapezoidal rule, of order 2: robust on coarse meshes and where controls jump."""

    @property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:
        return np.array([0.0, 1.0])

    @property
    @override
    def order(self) -> int:
        return 2


@final
@dataclass(frozen=True)
class HermiteSimpson(AbstractScheme):
    """The Hermite-Simpson method of order 4, with the midpoint state as a variable (Lobatto IIIA)."""

    @property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:
        return np.array([0.0, 0.5, 1.0])

    @property
    @override
    def order(self) -> int:
        return 4


@dataclass(frozen=True)
class _AbstractQuadrature(AbstractScheme):
    """A scheme whose stages are the points of a quadrature, as many as are asked for.

    Raises `ProblemError` unless there are 1 to 12 stages.
    """

    stages: int = 3

    def __post_init__(self) -> None:
        who = type(self).__name__
        if whole(f"{who}: stages", self.stages) > _MOST_STAGES:
            raise ProblemError(f"{who}: expected 1 to {_MOST_STAGES} stages; received {self.stages}.")

    @override
    def __str__(self) -> str:
        return f"{type(self).__name__}({self.stages})"


@final
@dataclass(frozen=True)
class Radau(_AbstractQuadrature):
    """Radau points, including the interval's end (Radau IIA), of order `2 stages - 1`: for stiff systems.

    Raises `ProblemError` unless there are 1 to 12 stages.
    """

    @cached_property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:  # pyright: ignore[reportIncompatibleMethodOverride]
        series = np.zeros(self.stages + 1)
        series[-2:] = -1.0, 1.0
        inner = np.sort(legendre.legroots(series).real)[:-1]
        return np.append((1 + inner) / 2, 1.0)

    @property
    @override
    def order(self) -> int:
        return 2 * self.stages - 1


@final
@dataclass(frozen=True)
class GaussLegendre(_AbstractQuadrature):
    """Gauss points, of order `2 stages`, without the ends: for long smooth motions and controls that jump.

    Raises `ProblemError` unless there are 1 to 12 stages.
    """

    @cached_property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return (1 + legendre.leggauss(self.stages)[0]) / 2

    @property
    @override
    def order(self) -> int:
        return 2 * self.stages
