"""Families with a tail: Exponential, LogNormal, Weibull and Gumbel, with the germs that are their own."""

from dataclasses import dataclass
from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.scipy import special
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library
from aleator.uncertainty._distribution import Canonical, Form
from aleator.uncertainty._families import AbstractFamily, Standard
from aleator.uncertainty._measure import AbstractDensityGerm
from aleator.uncertainty._polynomials import HermiteGerm, LaguerreGerm
from aleator.uncertainty._quantiles import bisect

_GUMBEL_STD = np.pi / np.sqrt(6)


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


def _weibull_dispersion(inverse: Array) -> Array:
    """`ln(1 + (std / mean)^2)` of the Weibull distribution, as a function of the reciprocal of its shape."""
    return special.gammaln(1 + 2 * inverse) - 2 * special.gammaln(1 + inverse)


@jax.jit
def _weibull_root(dispersion: Array) -> Array:
    fraction = bisect(lambda y: _weibull_dispersion(y / (1 - y)) < dispersion, dispersion)
    return jnp.where(dispersion > 0, fraction / (1 - fraction), 0.0)


@jax.custom_jvp
def weibull_inverse_shape(dispersion: Array) -> Array:
    """The reciprocal of the shape of the Weibull distribution with the dispersion `ln(1 + (std / mean)^2)`."""
    return _weibull_root(dispersion)


@weibull_inverse_shape.defjvp
def _weibull_inverse_shape_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    inverse = weibull_inverse_shape(*primals)
    return inverse, tangents[0] / (2 * special.digamma(1 + 2 * inverse) - 2 * special.digamma(1 + inverse))


@final
class Exponential(AbstractFamily):
    """Exponential distribution above `lower`, default 0: `Exponential(mean=2.0)` or `Exponential(rate=0.5)`.

    `mean` is that of the number itself, `lower` included; `rate` is the reciprocal of the standard deviation. Laguerre
    polynomials.
    """

    STANDARD: ClassVar[Standard] = Standard(LaguerreGerm(1.0), lambda normal: -special.log_ndtr(-normal))
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("mean", "lower"): Form(lambda mean, lower: Canonical(lower, mean - lower)),
        ("rate", "lower"): Form(lambda rate, lower: Canonical(lower, 1 / rate)),
    }
    REQUIRES: ClassVar[str] = "a finite mean above lower, or a finite rate above 0"

    def __init__(self, *, mean: Any = None, rate: Any = None, lower: Any = 0.0, shared_name: str | None = None):
        self.set_parameters({"mean": mean, "rate": rate, "lower": lower}, shared_name)


def _lognormal_from_moments(mean: Scalar, std: Scalar, lower: Scalar) -> Canonical:
    xp, mean, std, lower = in_library(mean, std, lower)
    variance = xp.log1p((std / (mean - lower)) ** 2)
    return Canonical(lower, (mean - lower) * xp.exp(-variance / 2), (xp.sqrt(variance),))


def _lognormal_std(log_std: Scalar) -> Scalar:
    xp, log_std = in_library(log_std)
    return xp.exp(log_std**2 / 2) * xp.sqrt(xp.expm1(log_std**2))


@final
class LogNormal(AbstractFamily):
    """Lognormal distribution above `lower`, default 0: `lower + exp(log_mean + log_std * xi)`, `xi` standard normal.

    Written `LogNormal(mean=2.0, std=0.5)`, by the moments of the number itself; `LogNormal(median=2.0, log_std=0.2)`,
    with the median `lower + exp(log_mean)`; or `LogNormal(log_mean=0.7, log_std=0.2)`. The germ is normal with Hermite
    polynomials, since polynomials in a lognormal number cannot represent every function of it (Ernst, Mugler, Starkloff
    and Ullmann, 2012).
    """

    STANDARD: ClassVar[Standard] = Standard(
        HermiteGerm(),
        # The number's excess over `lower`, as a multiple of its median.
        from_normal=lambda normal, log_std: jnp.exp(log_std * normal),
        mean=lambda log_std: in_library(log_std)[0].exp(log_std**2 / 2),
        std=_lognormal_std,
    )
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("mean", "std", "lower"): Form(_lognormal_from_moments, frozenset({"mean", "std", "lower"})),
        ("median", "log_std", "lower"): Form(
            lambda median, log_std, lower: Canonical(lower, median - lower, (log_std,)), frozenset({"log_std"})
        ),
        ("log_mean", "log_std", "lower"): Form(
            lambda log_mean, log_std, lower: Canonical(lower, in_library(log_mean)[0].exp(log_mean), (log_std,)),
            frozenset({"log_std"}),
        ),
    }
    REQUIRES: ClassVar[str] = "finite parameters, a mean or median above lower, and a std or log_std above 0"
    REACHES_ENDS: ClassVar[bool] = False

    def __init__(
        self,
        *,
        mean: Any = None,
        std: Any = None,
        median: Any = None,
        log_mean: Any = None,
        log_std: Any = None,
        lower: Any = 0.0,
        shared_name: str | None = None,
    ):
        parameters = {
            "mean": mean,
            "std": std,
            "median": median,
            "log_mean": log_mean,
            "log_std": log_std,
            "lower": lower,
        }
        self.set_parameters(parameters, shared_name)

    @override
    def value(self, germ: Float[Array, ""], reference: tuple[Scalar, ...] | None = None) -> Float[Array, ""]:
        """The germ is standard normal whatever the shape."""
        del reference
        return self.value_at_normal(germ)

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        return self.parameters["lower"], np.inf


def _weibull_from_moments(mean: Scalar, std: Scalar, lower: Scalar) -> Canonical:
    xp, mean, std, lower = in_library(mean, std, lower)
    xp, inverse = in_library(weibull_inverse_shape(xp.log1p((std / (mean - lower)) ** 2)))
    return Canonical(lower, (mean - lower) / xp.exp(_log_gamma(1 + inverse)), (1 / inverse,))


def _log_gamma(number: Scalar) -> Scalar:
    library, number = in_library(number)
    return (scipy.special.gammaln if library is np else special.gammaln)(number)


def _weibull_mean(shape: Scalar) -> Scalar:
    library, shape = in_library(shape)
    return library.exp(_log_gamma(1 + 1 / shape))


def _weibull_std(shape: Scalar) -> Scalar:
    library, shape = in_library(shape)
    first, second = _log_gamma(1 + 1 / shape), _log_gamma(1 + 2 / shape)
    return library.exp(first) * library.sqrt(library.expm1(second - 2 * first))


@final
class Weibull(AbstractFamily):
    """Weibull distribution above `lower`, default 0: `F(x) = 1 - exp(-((x - lower) / scale)^shape)`.

    `Weibull(scale=2.0, shape=1.5)` or, by the moments of the number itself, `Weibull(mean=2.0, std=0.5)`.
    """

    STANDARD: ClassVar[Standard] = Standard(
        WeibullGerm,
        from_normal=lambda normal, shape: (-special.log_ndtr(-normal)) ** (1 / shape),
        transport=lambda germ, source, target: germ ** (source[0] / target[0]),
        mean=_weibull_mean,
        std=_weibull_std,
    )
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("scale", "shape", "lower"): Form(
            lambda scale, shape, lower: Canonical(lower, scale, (shape,)), frozenset({"shape"})
        ),
        ("mean", "std", "lower"): Form(_weibull_from_moments, frozenset({"mean", "std", "lower"})),
    }
    REQUIRES: ClassVar[str] = (
        "a finite lower with a finite scale and shape above 0, or a finite mean above lower and a finite std above 0"
    )

    def __init__(
        self,
        scale: Any = None,
        shape: Any = None,
        *,
        mean: Any = None,
        std: Any = None,
        lower: Any = 0.0,
        shared_name: str | None = None,
    ):
        self.set_parameters({"scale": scale, "shape": shape, "mean": mean, "std": std, "lower": lower}, shared_name)


@final
class Gumbel(AbstractFamily):
    """Gumbel distribution of maxima: `F(x) = exp(-exp(-(x - location) / scale))`.

    `Gumbel(location=1.0, scale=0.2)`, where `location` is the mode, or `Gumbel(mean=1.1, std=0.25)`. The distribution
    of minima is that of the negative of such a number.
    """

    STANDARD: ClassVar[Standard] = Standard(
        GumbelGerm(),
        from_normal=lambda normal: -jnp.log(-special.log_ndtr(normal)),
        mean=lambda: np.euler_gamma,
        std=lambda: _GUMBEL_STD,
    )
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("location", "scale"): Form(Canonical),
        ("mean", "std"): Form(
            lambda mean, std: Canonical(mean - np.euler_gamma * std / _GUMBEL_STD, std / _GUMBEL_STD)
        ),
    }
    REQUIRES: ClassVar[str] = "a finite location or mean, and a finite scale or std above 0"

    def __init__(
        self,
        location: Any = None,
        scale: Any = None,
        *,
        mean: Any = None,
        std: Any = None,
        shared_name: str | None = None,
    ):
        self.set_parameters({"location": location, "scale": scale, "mean": mean, "std": std}, shared_name)
