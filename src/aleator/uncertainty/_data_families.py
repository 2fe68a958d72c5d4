"""Distributions given by a density function or by data: Density and Sample, each with its germ."""

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy import special
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import real_array, refusal, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator.uncertainty._distribution import AbstractDistribution, Canonical, Form
from aleator.uncertainty._measure import AbstractDensityGerm, recurrence_of
from aleator.uncertainty._polynomials import AbstractGerm

_NORMALS = np.linspace(-8.2, 8.2, 4101)


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
    def gauss(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """At most as many nodes as distinct values, which are exact for any function."""
        return super().gauss(count) if count < self.values.size else (self.values, self.weights)

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


@final
class Density(AbstractDistribution):
    """Any density: the number is `location + scale * xi`, and `xi` has the density `function` on (lower, upper).

    `function` takes a NumPy array of points and returns a non-negative number for each; it need not be normalised, and
    may have kinks, zeros and jumps. Bounds may be infinite; a density may be singular only at an end that is 0, since
    floating-point numbers are dense only there. Its polynomials come from a discretised Stieltjes procedure. `location`
    and `scale` may be decisions; nothing inside `function` may be.

    Peaks are sought on 65 536 evenly spread points. One that is narrower than 1e-5 of the range between the bounds, or
    under an infinite bound than a thousandth of the spread, may be missed: nothing else tells of its mass.

    Raises `ProblemError` if `function` is not a density, or if the mean or standard deviation does not exist.
    """

    xi: DensityGerm = eqx.field(static=True)

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {("location", "scale"): Form(Canonical)}
    REQUIRES: ClassVar[str] = "a finite location and a finite scale above 0"

    def __init__(
        self,
        function: Callable[[np.ndarray], np.ndarray],
        lower: float,
        upper: float,
        *,
        location: Any = 0.0,
        scale: Any = 1.0,
        shared_name: str | None = None,
    ):
        if not callable(function):
            raise ProblemError(f"Density takes a function of an array of points; received {function!r}.")
        ends = _ends(lower, upper)
        self.xi = DensityGerm(function, *ends)
        self.xi.recurrence(1)
        self.set_parameters({"location": location, "scale": scale}, shared_name)

    @override
    def germ(self) -> AbstractGerm:
        return self.xi

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        del shape
        return _cubic(normal, *_quantiles_by_normal(self.xi))

    def __str__(self) -> str:
        name = getattr(self.xi.function, "__name__", "function")
        return super().__str__().replace("(", f"({name} on [{self.xi.low:g}, {self.xi.high:g}], ", 1)


def _ends(lower: Any, upper: Any) -> tuple[float, float]:
    expected = "a plain number (let `location` and `scale` be the decisions)"
    low, high = (real_array(f"Density: {name}", end, expected) for name, end in (("lower", lower), ("upper", upper)))
    if low.ndim or high.ndim:
        raise refusal("Density: its bounds", "plain numbers", (lower, upper))
    low, high = float(low), float(high)
    if not low < high:
        raise ProblemError(f"Density needs lower < upper; received lower={low:g}, upper={high:g}.")
    return low, high


@functools.lru_cache(maxsize=32)
def _quantiles_by_normal(germ: DensityGerm) -> tuple[np.ndarray, np.ndarray]:
    """The germ's quantiles at the probabilities of `_NORMALS`, and their derivatives."""
    quantiles = germ.quantile(scipy.special.ndtr(_NORMALS))
    return quantiles, scipy.interpolate.PchipInterpolator(_NORMALS, quantiles).derivative()(_NORMALS)


def _cubic(x: Array, values: np.ndarray, slopes: np.ndarray) -> Array:
    """Cubic Hermite interpolation on `_NORMALS`."""
    step = _NORMALS[1] - _NORMALS[0]
    at = jnp.clip((x - _NORMALS[0]) / step, 0, _NORMALS.size - 1)
    i = jnp.clip(jnp.floor(jnp.asarray(at)).astype(int), 0, _NORMALS.size - 2)
    t = at - i
    left, right, rise, fall = (jnp.asarray(column)[j] for column in (values, slopes) for j in (i, i + 1))
    return (
        left * (1 + 2 * t) * (1 - t) ** 2
        + right * (3 - 2 * t) * t**2
        + step * (rise * t * (1 - t) ** 2 - fall * t**2 * (1 - t))
    )


@final
class Sample(AbstractDistribution):
    """The distribution of measured data: the number is `location + scale * xi`, and `xi` is each of the `data` with
    equal probability.

    It is the empirical distribution in every respect: polynomials (arbitrary polynomial chaos), mean, standard
    deviation (divided by n, not by n - 1), quantiles and drawn values are those of the data; no other value ever
    occurs. The order of an expansion must be less than the number of distinct values. For values between the data, fit
    a distribution or give a `Density`. `al.MultiElement` refuses data, which no element divides.

    Raises `ProblemError` unless the data are at least two distinct, finite numbers.
    """

    xi: SampleGerm = eqx.field(static=True)

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {("location", "scale"): Form(Canonical)}
    REQUIRES: ClassVar[str] = "a finite location and a finite scale above 0"

    def __init__(self, data: Any, *, location: Any = 0.0, scale: Any = 1.0, shared_name: str | None = None):
        self.xi = SampleGerm(_data(data))
        self.set_parameters({"location": location, "scale": scale}, shared_name)

    @override
    def germ(self) -> AbstractGerm:
        return self.xi

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        del shape
        return jnp.asarray(self.xi.values)[jnp.searchsorted(jnp.asarray(self.xi.levels), special.ndtr(normal))]

    def __str__(self) -> str:
        return super().__str__().replace("(", f"({self.xi.values.size} distinct values, ", 1)


def _data(data: Any) -> Float[np.ndarray, " n"]:
    values = real_array("Sample", data, "a list or vector of numbers")
    refuse_not_finite("Sample: data", values)
    if values.ndim != 1 or np.unique(values).size < 2:
        raise ProblemError(
            "Sample: data: expected a vector of numbers of which at least two differ; received an array of shape "
            f"{values.shape}."
        )
    return values
