"""The families of distributions (dissertation, table 4.1): Uniform, Normal, Beta and Gamma."""

from typing import Any, ClassVar, Self, final

import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.errors import ProblemError
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._parameters import Canonical, Form
from aleator.uncertainty._polynomials import AbstractGerm, HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from aleator.uncertainty._transport import beta_anchor, beta_quantile, gamma_anchor, gamma_quantile


@final
class Uniform(AbstractDistribution):
    """Uniform distribution: `Uniform(376.0, half_width=47.0)`, `Uniform(376.0, std=27.1)`, `Uniform.bounds(329, 423)`.

    Its germ is uniform on [-1, 1] with Legendre polynomials; the half-width is the coefficient `theta^1` of equation
    (114). The standard deviation is the half-width divided by the square root of 3.
    """

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("mean", "half_width"): Form(lambda mean, half_width: Canonical(mean, half_width)),
        ("mean", "std"): Form(lambda mean, std: Canonical(mean, std * np.sqrt(3.0))),
        ("lower", "upper"): Form(lambda lower, upper: Canonical((lower + upper) / 2, (upper - lower) / 2)),
    }

    def __init__(
        self,
        mean: Any = None,
        unnamed: Any = None,
        *,
        half_width: Any = None,
        std: Any = None,
        lower: Any = None,
        upper: Any = None,
        shared_name: str | None = None,
    ):
        if unnamed is not None:
            raise ProblemError(
                "Uniform takes one positional number, its mean: expected Uniform(mean, half_width=...), Uniform(mean, "
                f"std=...) or Uniform.bounds(lower, upper); received a second positional number, {unnamed!r}."
            )
        given = {"mean": mean, "half_width": half_width, "std": std, "lower": lower, "upper": upper}
        self.set_parameters(given, shared_name)

    @classmethod
    def bounds(cls, lower: Any, upper: Any) -> Self:
        """Uniform between two bounds."""
        return cls(lower=lower, upper=upper)

    @override
    def germ(self) -> AbstractGerm:
        return LegendreGerm()

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        del shape
        return special.erf(normal / np.sqrt(2.0))

    @override
    def mean(self) -> Scalar:
        return self.canonical().location

    @override
    def std(self) -> Scalar:
        return self.canonical().scale / np.sqrt(3.0)

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        location, scale, _ = self.canonical()
        return location - scale, location + scale


@final
class Normal(AbstractDistribution):
    """Normal distribution with `mean` and standard deviation `std`: standard normal germ, Hermite polynomials."""

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {("mean", "std"): Form(lambda mean, std: Canonical(mean, std))}

    def __init__(self, mean: Any = None, std: Any = None, *, shared_name: str | None = None):
        self.set_parameters({"mean": mean, "std": std}, shared_name)

    @override
    def germ(self) -> AbstractGerm:
        return HermiteGerm()

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        del shape
        return normal

    @override
    def mean(self) -> Scalar:
        return self.canonical().location

    @override
    def std(self) -> Scalar:
        return self.canonical().scale

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        return -np.inf, np.inf


def _beta_from_shape(alpha: Scalar, beta: Scalar, lower: Scalar, upper: Scalar) -> Canonical:
    return Canonical((lower + upper) / 2, (upper - lower) / 2, (alpha, beta))


def _beta_from_moments(mean: Scalar, std: Scalar, lower: Scalar, upper: Scalar) -> Canonical:
    centre = (mean - lower) / (upper - lower)
    total = centre * (1 - centre) * ((upper - lower) / std) ** 2 - 1
    return _beta_from_shape(centre * total, (1 - centre) * total, lower, upper)


@final
class Beta(AbstractDistribution):
    """Beta distribution on [lower, upper], default [0, 1].

    `Beta(alpha=2.0, beta=5.0)` or, by its moments, `Beta(mean=0.3, std=0.1)`; Jacobi polynomials.
    """

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("alpha", "beta", "lower", "upper"): Form(_beta_from_shape, frozenset({"alpha", "beta"})),
        ("mean", "std", "lower", "upper"): Form(_beta_from_moments, frozenset({"mean", "std", "lower", "upper"})),
    }

    def __init__(
        self,
        *,
        alpha: Any = None,
        beta: Any = None,
        mean: Any = None,
        std: Any = None,
        lower: Any = 0.0,
        upper: Any = 1.0,
        shared_name: str | None = None,
    ):
        given = {"alpha": alpha, "beta": beta, "mean": mean, "std": std, "lower": lower, "upper": upper}
        self.set_parameters(given, shared_name)

    @override
    def germ(self) -> AbstractGerm:
        return JacobiGerm(*self.concrete_shape())

    @override
    def transport(self, germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
        alpha, beta = source
        below, above = special.betainc(alpha, beta, (1 + germ) / 2), special.betainc(beta, alpha, (1 - germ) / 2)
        return 2 * beta_quantile(below, above, *target) - 1

    @override
    def anchor(self, germ: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        return 2 * beta_anchor((1 + germ) / 2, *shape) - 1

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        return 2 * beta_quantile(special.ndtr(normal), special.ndtr(-normal), *shape) - 1

    @override
    def mean(self) -> Scalar:
        location, scale, (alpha, beta) = self.canonical()
        return location + scale * (alpha - beta) / (alpha + beta)

    @override
    def std(self) -> Scalar:
        _, scale, (alpha, beta) = self.canonical()
        return 2 * scale * jnp.sqrt(alpha * beta / (alpha + beta + 1)) / (alpha + beta)

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        return self.parameters["lower"], self.parameters["upper"]


def _gamma_from_moments(mean: Scalar, std: Scalar, lower: Scalar) -> Canonical:
    return Canonical(lower, std**2 / (mean - lower), (((mean - lower) / std) ** 2,))


@final
class Gamma(AbstractDistribution):
    """Gamma distribution above `lower`, default 0.

    `Gamma(shape=4.0, scale=0.5)` or, by its moments, `Gamma(mean=2.0, std=1.0)`; Laguerre polynomials.
    """

    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {
        ("shape", "scale", "lower"): Form(
            lambda shape, scale, lower: Canonical(lower, scale, (shape,)), frozenset({"shape"})
        ),
        ("mean", "std", "lower"): Form(_gamma_from_moments, frozenset({"mean", "std", "lower"})),
    }

    def __init__(
        self,
        *,
        shape: Any = None,
        scale: Any = None,
        mean: Any = None,
        std: Any = None,
        lower: Any = 0.0,
        shared_name: str | None = None,
    ):
        self.set_parameters({"shape": shape, "scale": scale, "mean": mean, "std": std, "lower": lower}, shared_name)

    @override
    def germ(self) -> AbstractGerm:
        return LaguerreGerm(*self.concrete_shape())

    @override
    def transport(self, germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
        return gamma_quantile(special.gammainc(source[0], germ), special.gammaincc(source[0], germ), *target)

    @override
    def anchor(self, germ: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        return gamma_anchor(germ, *shape)

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        return gamma_quantile(special.ndtr(normal), special.ndtr(-normal), *shape)

    @override
    def mean(self) -> Scalar:
        lower, scale, (shape,) = self.canonical()
        return lower + scale * shape

    @override
    def std(self) -> Scalar:
        _, scale, (shape,) = self.canonical()
        return scale * jnp.sqrt(shape)

    @override
    def support(self) -> tuple[Scalar, Scalar]:
        return self.parameters["lower"], np.inf
