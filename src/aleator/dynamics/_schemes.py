"""Schemes for simultaneous transcription: how states follow from mean rates between nodes; those of collocation.

Over each interval of a mesh a collocation scheme's states are polynomials whose rates agree with the dynamics at its
stages. The schemes differ only in the positions of their stages (Hairer, Nørsett and Wanner, Solving Ordinary
Differential Equations I, II.7; Betts, Practical Methods for Optimal Control, chapter 4).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias, final

import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial import legendre
from typing_extensions import override

from aleator._core.border import whole
from aleator._core.errors import ProblemError

Rate: TypeAlias = Callable[[Array, Array, Array], Float[Array, " rates"]]
"""The rates of states, then integrands, at a place in time, with the signals and the states there."""

# With more stages the points lose accuracy in 64-bit arithmetic, without any gain.
MOST_STAGES = 12


class AbstractMeanRate(abc.ABC):
    """What one block of a scheme is: a mean of rates, from the states where it begins.

    `steps`: steps in time that an interval of a mesh stands for.
    """

    steps: int

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

    steps: int = 1

    @override
    def __call__(
        self,
        rate: Rate,
        places: Float[Array, "told 2"],
        signals: Float[Array, "told signals"],
        states: Float[Array, " states"],
    ) -> Float[Array, " rates"]:
        return rate(places[0], signals[0], states)


@dataclass(frozen=True)
class AbstractScheme(abc.ABC):
    """How states follow over an interval of a mesh of length h: `x_i = x_0 + h Σ_j w_ij r_j` at its points.

    The blocks `r_j` are mean rates, from what is known at the points where they begin.
    """

    def __str__(self) -> str:
        return type(self).__name__

    def raised(self, most: int) -> "tuple[AbstractScheme, ...]":
        """The schemes of the same kind with more stages, up to so many, in ascending order; none by default."""
        del most
        return ()

    @property
    @abc.abstractmethod
    def order(self) -> int:
        """The order of convergence of the states at the nodes in the interval's length."""

    @property
    @abc.abstractmethod
    def rate(self) -> AbstractMeanRate:
        """What a block is: schemes with the same one share what is compiled."""

    @property
    @abc.abstractmethod
    def has_algebraic_variables(self) -> bool:
        """Whether algebraic variables are variables of the program too, wherever signals are told."""

    @property
    @abc.abstractmethod
    def points(self) -> Float[np.ndarray, " points"]:
        """The points where states are variables, as fractions of the interval: both ends are among them."""

    @property
    @abc.abstractmethod
    def told(self) -> Float[np.ndarray, " told"]:
        """Where signals are told, as fractions of the interval: both ends are among them."""

    @property
    @abc.abstractmethod
    def asked(self) -> slice:
        """The slice, among the points, of those where the blocks begin."""

    @property
    @abc.abstractmethod
    def seen(self) -> Int[np.ndarray, "blocks seen"]:
        """Of what is told, what each block depends on."""

    @property
    @abc.abstractmethod
    def weights(self) -> Float[np.ndarray, "later blocks"]:
        """The weights of the blocks in the states at each later point, for a unit interval."""

    @property
    @abc.abstractmethod
    def quadrature(self) -> Float[np.ndarray, " told"]:
        """The weights of what is told in integrals over a unit interval."""

    @property
    @abc.abstractmethod
    def estimated_order(self) -> int:
        """The order in the interval's length, less one, of what its states are estimated to err by."""


@dataclass(frozen=True)
class AbstractCollocation(AbstractScheme):
    """A collocation scheme, determined by its stages: over an interval the states are polynomials whose rates agree
    with the dynamics there.
    """

    @property
    @abc.abstractmethod
    def nodes(self) -> Float[np.ndarray, " stages"]:
        """The stages: points where rates agree with the dynamics, as increasing fractions of an interval."""

    @property
    @override
    def order(self) -> int:
        """Twice the number of stages, less one for each end of the interval among them."""
        return 2 * len(self.nodes) - int(self.nodes[0] == 0) - int(self.nodes[-1] == 1)

    @property
    @override
    def rate(self) -> AbstractMeanRate:
        return PointRate()

    @property
    @override
    def has_algebraic_variables(self) -> bool:
        return True

    @cached_property
    @override
    def points(self) -> Float[np.ndarray, " points"]:  # pyright: ignore[reportIncompatibleMethodOverride]
        inner = [node for node in self.nodes if 0 < node < 1]
        return np.array([0.0, *inner, 1.0])

    @property
    @override
    def told(self) -> Float[np.ndarray, " told"]:
        return self.points

    @cached_property
    @override
    def asked(self) -> slice:  # pyright: ignore[reportIncompatibleMethodOverride]
        return slice(0 if self.nodes[0] == 0 else 1, None if self.nodes[-1] == 1 else -1)

    @property
    @override
    def seen(self) -> Int[np.ndarray, "blocks seen"]:
        return np.arange(len(self.points))[self.asked, None]

    @property
    @override
    def quadrature(self) -> Float[np.ndarray, " told"]:
        weights = np.zeros(len(self.told))
        weights[self.asked] = self.weights[-1]
        return weights

    @property
    @override
    def estimated_order(self) -> int:
        return len(self.nodes)

    @cached_property
    @override
    def weights(self) -> Float[np.ndarray, "later stages"]:  # pyright: ignore[reportIncompatibleMethodOverride]
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
        return integrals @ self.spectrum / 2

    def interpolated(self, at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n stages"]:
        """The rates' interpolant at other points of the interval, from the rates at the stages."""
        return legendre.legvander(2 * np.asarray(at) - 1, len(self.nodes) - 1) @ self.spectrum

    @cached_property
    def spectrum(self) -> Float[np.ndarray, "degrees stages"]:
        """From the rates at the stages to their interpolant's coefficients in Legendre polynomials."""
        return np.linalg.inv(legendre.legvander(2 * self.nodes - 1, len(self.nodes) - 1))


def _integral(values: Float[np.ndarray, "points degrees"], degree: int) -> Float[np.ndarray, " points"]:
    """An integral of a Legendre polynomial, from the values of all polynomials up to one degree more."""
    return values[:, 1] if degree == 0 else (values[:, degree + 1] - values[:, degree - 1]) / (2 * degree + 1)


@final
@dataclass(frozen=True)
class Trapezoid(AbstractCollocation):
    """The trapezoidal rule, of order 2: robust on coarse meshes and where controls jump."""

    @property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:
        return np.array([0.0, 1.0])


@final
@dataclass(frozen=True)
class HermiteSimpson(AbstractCollocation):
    """The Hermite-Simpson method of order 4, with the midpoint state as a variable (Lobatto IIIA)."""

    @property
    @override
    def nodes(self) -> Float[np.ndarray, " stages"]:
        return np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True)
class _AbstractQuadrature(AbstractCollocation):
    """A scheme whose stages are the points of a quadrature, as many as are asked for.

    Raises `ProblemError` unless there are 1 to 12 stages.
    """

    stages: int = 3

    def __post_init__(self) -> None:
        who = type(self).__name__
        if whole(f"{who}: stages", self.stages) > MOST_STAGES:
            raise ProblemError(f"{who}: expected 1 to {MOST_STAGES} stages; received {self.stages}.")

    @override
    def raised(self, most: int) -> tuple[AbstractScheme, ...]:
        return tuple(replace(self, stages=count) for count in range(self.stages + 1, most + 1))

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
