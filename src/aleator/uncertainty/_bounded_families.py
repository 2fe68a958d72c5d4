"""Families between bounds whose polynomials have no closed form: Triangular and TruncatedNormal, each with its germ."""

from dataclasses import dataclass
from typing import Any, ClassVar, final

import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library
from aleator.uncertainty._distribution import Canonical, Form
from aleator.uncertainty._families import AbstractFamily, Standard
from aleator.uncertainty._measure import AbstractDensityGerm

_FURTHEST = 37.0  # scales from the mean, beyond which a normal distribution has no mass
_REACH = 80.0  # the density is 1e-17 of its peak where half the square of the germ has grown by half of this
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)


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
        return _triangular_quantile(level, 1 - level, self.mode)

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


def _triangular_quantile(below: Any, above: Any, mode: Scalar) -> Any:
    """Quantile on [-1, 1], given the probabilities below and above."""
    library, below, above, mode = in_library(below, above, mode)
    left = below < mode
    square = library.where(left, mode * below, (1 - mode) * above)
    # The ends do not move with the mode.
    distance = library.where(square > 0, 2 * library.sqrt(library.where(square > 0, square, 1.0)), 0.0)
    return library.where(left, distance - 1, 1 - distance)


def _triangular_transport(germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
    (mode,) = source
    left = germ < 2 * mode - 1
    side = jnp.where(left, mode, 1 - mode)
    mass = (jnp.where(left, 1 + germ, 1 - germ) / 2) ** 2 / side
    below, above = jnp.where(left, mass, 1 - mass), jnp.where(left, 1 - mass, mass)
    return _triangular_quantile(below, above, *target)


@final
class Triangular(AbstractFamily):
    """Triangular distribution: `Triangular(lower=1.0, mode=2.0, upper=4.0)`, where the mode may lie on a bound.

    A symmetric one may be written `Triangular(mean=2.0, half_width=1.0)`.

    A mode that is a decision moves a kink through the germ, which polynomials hardly resolve at any order: designs that
    follow from derivatives by it are seldom `ok`.
    """

    STANDARD: ClassVar[Standard] = Standard(
        TriangularGerm,
        from_normal=lambda normal, mode: _triangular_quantile(special.ndtr(normal), special.ndtr(-normal), mode),
        transport=_triangular_transport,
        mean=lambda mode: (2 * mode - 1) / 3,
        std=lambda mode: jnp.sqrt((1 - mode + mode**2) * 2 / 9),
    )
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("lower", "mode", "upper"): Form(
            lambda lower, mode, upper: Canonical(
                (lower + upper) / 2, (upper - lower) / 2, ((mode - lower) / (upper - lower),)
            ),
            frozenset({"lower", "mode", "upper"}),
        ),
        ("mean", "half_width"): Form(lambda mean, half_width: Canonical(mean, half_width, (0.5,))),
    }
    REQUIRES: ClassVar[str] = "finite lower <= mode <= upper with lower < upper, or a finite half_width above 0"

    def __init__(
        self,
        lower: Any = None,
        mode: Any = None,
        upper: Any = None,
        *,
        mean: Any = None,
        half_width: Any = None,
        shared_name: str | None = None,
    ):
        parameters = {"lower": lower, "mode": mode, "upper": upper, "mean": mean, "half_width": half_width}
        self.set_parameters(parameters, shared_name)

    def _is_possible(self, parameters: dict[str, float], shape: tuple[float, ...]) -> bool:
        del parameters
        return 0 <= shape[0] <= 1


def _standardised(bound: Scalar, location: Scalar, scale: Scalar) -> Scalar:
    """The bound in scales from the location; infinite where no mass lies beyond. The derivatives of infinite ones would
    be NaN.
    """
    xp, bound, location, scale = in_library(bound, location, scale)
    finite = xp.isfinite(bound)
    end = xp.where(finite, (xp.where(finite, bound, location) - location) / scale, bound)
    return xp.where(end > _FURTHEST, np.inf, xp.where(end < -_FURTHEST, -np.inf, end))


def _mass(low: Array, high: Array) -> Array:
    """Standard normal probability between two points, from the tail in which they lie."""
    return jnp.where(low > 0, special.ndtr(-low) - special.ndtr(-high), special.ndtr(high) - special.ndtr(low))


def _truncated_quantile(below: Array, above: Array, low: Array, high: Array) -> Array:
    """Quantile of the truncated standard normal distribution, inverted from the end with the smaller tail."""
    mass = _mass(low, high)
    from_high = (low > 0) | ((high > 0) & (below > above))
    tail = jnp.where(from_high, special.ndtr(-high) + above * mass, special.ndtr(low) + below * mass)
    return jnp.where(from_high, -1, 1) * special.ndtri(tail)


def _truncated_moments(low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
    """Mean and standard deviation of the truncated standard normal distribution.

    Computed by Gauss quadrature, whose error is below rounding here: the closed form loses all digits in a tail or in a
    narrow interval.
    """
    xp, low, high = in_library(low, high)
    first = xp.maximum(low, -xp.sqrt(xp.maximum(-high, 0) ** 2 + _REACH))
    last = xp.minimum(high, xp.sqrt(xp.maximum(low, 0) ** 2 + _REACH))
    z = (first + last) / 2 + (last - first) / 2 * _NODES
    peak = xp.clip(0.0, low, high)
    weights = xp.exp(-(z - peak) * (z + peak) / 2) * _WEIGHTS
    weights = weights / xp.sum(weights)
    mean = xp.sum(weights * z)
    return mean, xp.sqrt(xp.sum(weights * (z - mean) ** 2))


def _truncated_normal(location: Scalar, scale: Scalar, lower: Scalar, upper: Scalar) -> Canonical:
    return Canonical(location, scale, (_standardised(lower, location, scale), _standardised(upper, location, scale)))


def _truncated_transport(germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
    low, high = source
    mass = _mass(low, high)
    return _truncated_quantile(_mass(low, germ) / mass, _mass(germ, high) / mass, *target)


@final
class TruncatedNormal(AbstractFamily):
    """Normal distribution truncated to the interval from `lower` to `upper`; one of the two may be omitted.

    `location` and `scale` are the mean and the standard deviation of the *untruncated* parent; `mean()` and `std()` are
    those of the truncated distribution.
    """

    STANDARD: ClassVar[Standard] = Standard(
        TruncatedNormalGerm,
        from_normal=lambda normal, *ends: _truncated_quantile(special.ndtr(normal), special.ndtr(-normal), *ends),
        transport=_truncated_transport,
        mean=lambda *ends: _truncated_moments(*ends)[0],
        std=lambda *ends: _truncated_moments(*ends)[1],
    )
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("location", "scale", "lower", "upper"): Form(
            _truncated_normal, frozenset({"location", "scale", "lower", "upper"})
        ),
    }
    REQUIRES: ClassVar[str] = (
        "a finite location and a finite scale above 0 (those of the normal distribution before truncation), and lower "
        "< upper with a part of the interval within 37 scales of the location"
    )

    def __init__(
        self,
        location: Any = None,
        scale: Any = None,
        *,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        shared_name: str | None = None,
    ):
        self.set_parameters({"location": location, "scale": scale, "lower": lower, "upper": upper}, shared_name)

    def _is_possible(self, parameters: dict[str, float], shape: tuple[float, ...]) -> bool:
        del parameters
        low, high = shape
        return low < high and low < _FURTHEST and high > -_FURTHEST

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        return self.parameters["lower"], self.parameters["upper"]
