"""Schemes for simultaneous transcription: how states follow from mean rates between nodes.

Over each interval of a mesh a collocation scheme's states are polynomials whose rates agree with the dynamics at its
stages. These schemes differ only in the positions of their stages (Hairer, Nørsett and Wanner, Solving Ordinary
Differential Equations I, II.7; Betts, Practical Methods for Optimal Control, chapter 4). In multiple shooting, states
are variables at nodes alone, and integrated from each to the next (Bock and Plitt, A multiple shooting algorithm for
direct solution of optimal control problems, IFAC 1984).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial import legendre
from typing_extensions import override

from aleator._core.border import refusal, whole
from aleator._core.errors import ProblemError
from aleator.dynamics._tableaux import RUNGE_KUTTA_4

Rate: TypeAlias = Callable[[Array, Array, Array], Float[Array, " rates"]]
"""The rates of states, then integrands, at a place in time, with the signals and the states there."""
Places: TypeAlias = Float[Array, "told 2"]
"""Where signals are told; the first number of each is the time."""
Signals: TypeAlias = Float[Array, "told signals"]
States: TypeAlias = Float[Array, " states"]

# With more stages the points lose accuracy in 64-bit arithmetic, without any gain.
MOST_STAGES = 12
_MOST_STEPS = 100

# Each stage of this rule depends on the one before alone, and signals are told twice a step.
_COUPLINGS = np.array([row[-1] if row else 0.0 for row in RUNGE_KUTTA_4.couplings])
_WEIGHTS, _TWICE = np.array(RUNGE_KUTTA_4.weights), (2 * np.array(RUNGE_KUTTA_4.nodes)).astype(int)


@dataclass(frozen=True)
class AbstractMeanRate(abc.ABC):
    """What one block of a scheme is: a mean of rates, from the states at the first of the places.

    - `steps`: steps in time that an interval of a mesh stands for.
    """

    steps: int = 1

    @abc.abstractmethod
    def __call__(self, rate: Rate, places: Places, signals: Signals, states: States) -> Float[Array, " rates"]:
        """The mean."""


@final
@dataclass(frozen=True)
class PointRate(AbstractMeanRate):
    """The rate at one point."""

    @override
    def __call__(self, rate: Rate, places: Places, signals: Signals, states: States) -> Float[Array, " rates"]:
        return rate(places[0], signals[0], states)


@final
@dataclass(frozen=True)
class SegmentRate(AbstractMeanRate):
    """The mean over a segment of time, by some equal steps of `RungeKutta4`.

    Signals are told at the ends and in the middle of each step.
    """

    @override
    def __call__(self, rate: Rate, places: Places, signals: Signals, states: States) -> Float[Array, " rates"]:
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
        where = self.places()
        every = (*(jnp.asarray(np.tile(one, self.steps)) for one in each), places[where], signals[where])
        # A loop over stages, not steps: a model is traced once, however many there are.
        (_, moved, _), _ = jax.lax.scan(stage, (zeros, zeros, zeros), every)
        return moved / self.steps

    def places(self) -> Int[np.ndarray, " stages"]:
        """Which of the places each stage of each step is at."""
        return (2 * np.arange(self.steps)[:, None] + _TWICE).ravel()

    @property
    def told(self) -> Float[np.ndarray, " told"]:
        """Where signals are told, as fractions of the segment."""
        return np.linspace(0.0, 1.0, 2 * self.steps + 1)

    @property
    def quadrature(self) -> Float[np.ndarray, " told"]:
        """The weights of what is told in a mean over the segment."""
        weights = np.zeros(2 * self.steps + 1)
        np.add.at(weights, self.places(), np.tile(_WEIGHTS, self.steps) / self.steps)
        return weights


class AbstractScheme(abc.ABC):
    """How states follow over an interval of a mesh of length h: `x_i = x_0 + h Σ_j w_ij r_j` at its points.

    The blocks `r_j` are mean rates, from what is known at the points where they begin.

    - `rate`: what a block is: schemes with the same one share what is compiled; `has_algebraic_variables`: whether
      algebraic variables are variables of the program too, wherever signals are told;
    - `order`: that of convergence of the states at the nodes in the interval's length; `estimated_order`: the one, less
      one, of what its states are estimated to err by;
    - `points`, `told`: where states are variables, and where signals are told, as fractions of the interval, with both
      ends; `asked`: the slice, among the points, of those where the blocks begin; `seen`: of what is told, what each
      block depends on;
    - `weights`: those of the blocks in the states at each later point, for a unit interval; `quadrature`: those of what
      is told in integrals over one.
    """

    rate: AbstractMeanRate
    has_algebraic_variables: bool
    order: int
    estimated_order: int
    points: Float[np.ndarray, " points"]
    told: Float[np.ndarray, " told"]
    asked: slice
    seen: Int[np.ndarray, "blocks seen"]
    weights: Float[np.ndarray, "later blocks"]
    quadrature: Float[np.ndarray, " told"]

    def __str__(self) -> str:
        return type(self).__name__

    def raised(self, most: int) -> "tuple[AbstractScheme, ...]":
        """The schemes of the same kind with more stages, up to so many, in ascending order; none by default."""
        del most
        return ()


class AbstractCollocation(AbstractScheme):
    """A collocation scheme, determined by its stages: over an interval the states are polynomials whose rates agree
    with the dynamics there.

    - `nodes`: the stages, as increasing fractions of an interval; `spectrum`: from the rates there to the coefficients
      of their interpolant in Legendre polynomials.

    The last row of `weights` is the scheme's quadrature.
    """

    nodes: Float[np.ndarray, " stages"]
    spectrum: Float[np.ndarray, "degrees stages"]

    def __post_init__(self) -> None:
        nodes = self.stages_at()
        at_start, at_end = bool(nodes[0] == 0), bool(nodes[-1] == 1)
        points = np.array([0.0, *(node for node in nodes if 0 < node < 1), 1.0])
        asked = slice(0 if at_start else 1, None if at_end else -1)
        spectrum = np.linalg.inv(legendre.legvander(2 * nodes - 1, len(nodes) - 1))
        # The fields of a frozen dataclass are those that tell schemes apart: all else follows from them.
        vars(self).update(rate=PointRate(), has_algebraic_variables=True, nodes=nodes, spectrum=spectrum)
        vars(self).update(order=2 * len(nodes) - at_start - at_end, estimated_order=len(nodes))
        weights, quadrature = self.integrals(points[1:]), np.zeros(len(points))
        quadrature[asked] = weights[-1]
        seen = np.arange(len(points))[asked, None]
        vars(self).update(points=points, told=points, asked=asked, seen=seen, weights=weights, quadrature=quadrature)

    @abc.abstractmethod
    def stages_at(self) -> Float[np.ndarray, " stages"]:
        """Where its stages are."""

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


def _integral(values: Float[np.ndarray, "points degrees"], degree: int) -> Float[np.ndarray, " points"]:
    """An integral of a Legendre polynomial, from the values of all polynomials up to one degree more."""
    return values[:, 1] if degree == 0 else (values[:, degree + 1] - values[:, degree - 1]) / (2 * degree + 1)


@final
@dataclass(frozen=True)
class Trapezoid(AbstractCollocation):
    """The trapezoidal rule, of order 2: robust on coarse meshes and where controls jump."""

    @override
    def stages_at(self) -> Float[np.ndarray, " stages"]:
        return np.array([0.0, 1.0])


@final
@dataclass(frozen=True)
class HermiteSimpson(AbstractCollocation):
    """The Hermite-Simpson method of order 4, with the midpoint state as a variable (Lobatto IIIA)."""

    @override
    def stages_at(self) -> Float[np.ndarray, " stages"]:
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
        super().__post_init__()

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

    @override
    def stages_at(self) -> Float[np.ndarray, " stages"]:
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

    @override
    def stages_at(self) -> Float[np.ndarray, " stages"]:
        return (1 + legendre.leggauss(self.stages)[0]) / 2


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
        segment = SegmentRate(self.steps)
        vars(self).update(rate=segment, has_algebraic_variables=False, order=4, estimated_order=4)
        vars(self).update(points=np.array([0.0, 1.0]), told=segment.told, asked=slice(0, 1))
        seen = np.arange(len(segment.told))[None]
        vars(self).update(seen=seen, weights=np.ones((1, 1)), quadrature=segment.quadrature)

    @override
    def __str__(self) -> str:
        return f"MultipleShooting({self.steps})"
