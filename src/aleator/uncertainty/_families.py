"""The families of distributions (dissertation, table 4.1): Uniform, Normal, Beta and Gamma."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self, final

import numpy as np
from jax.scipy import special
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library
from aleator._core.errors import ProblemError
from aleator.uncertainty._distribution import AbstractDistribution, Canonical, Form
from aleator.uncertainty._polynomials import AbstractGerm, HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from aleator.uncertainty._quantiles import beta_anchor, beta_quantile, gamma_anchor, gamma_quantile


class Standard(NamedTuple):
    """The germ of a family as functions of its shape parameters.

    - `germ`: its distribution, of known shapes; `from_normal(normal, *shape)`: see `AbstractDistribution`;
    - `transport(germ, source, target)`, `anchor(germ, *shape)`: likewise; None for families without a shape;
    - `mean`, `std`: its moments; None to take them from its polynomials.
    """

    germ: AbstractGerm | Callable[..., AbstractGerm]
    from_normal: Callable[..., Array]
    transport: Callable[..., Array] | None = None
    anchor: Callable[..., Array] | None = None
    mean: Callable[..., Scalar] | None = None
    std: Callable[..., Scalar] | None = None


NORMAL = Standard(HermiteGerm(), lambda normal: normal)


class AbstractFamily(AbstractDistribution):
    """A distribution whose germ is described by data."""

    STANDARD: ClassVar[Standard]

    @override
    def germ(self) -> AbstractGerm:
        germ = self.STANDARD.germ
        return germ if isinstance(germ, AbstractGerm) else germ(*self.concrete_shape())

    @override
    def from_normal(self, normal: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        return self.STANDARD.from_normal(normal, *shape)

    @override
    def transport(self, germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
        return germ if self.STANDARD.transport is None else self.STANDARD.transport(germ, source, target)

    @override
    def anchor(self, germ: Float[Array, ""], shape: tuple) -> Float[Array, ""]:
        anchor = self.STANDARD.anchor
        return super().anchor(germ, shape) if anchor is None else anchor(germ, *shape)

    @override
    def mean(self) -> Scalar:
        if self.STANDARD.mean is None:
            return super().mean()
        location, scale, shape = self.canonical()
        return location + scale * self.STANDARD.mean(*shape)

    @override
    def std(self) -> Scalar:
        if self.STANDARD.std is None:
            return super().std()
        _, scale, shape = self.canonical()
        return scale * self.STANDARD.std(*shape)


@final
class Uniform(AbstractFamily):
    """Uniform distribution: `Uniform(376.0, half_width=47.0)`, `Uniform(376.0, std=27.1)`, `Uniform.bounds(329, 423)`.

    Its germ is uniform on [-1, 1] with Legendre polynomials; the half-width is the coefficient `theta^1` of equation
    (114). The standard deviation is the half-width divided by the square root of 3.
    """

    STANDARD: ClassVar[Standard] = Standard(LegendreGerm(), lambda normal: special.erf(normal / np.sqrt(2.0)))
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
        parameters = {"mean": mean, "half_width": half_width, "std": std, "lower": lower, "upper": upper}
        self.set_parameters(parameters, shared_name)

    @classmethod
    def bounds(cls, lower: Any, upper: Any) -> Self:
        """Uniform between two bounds."""
        return cls(lower=lower, upper=upper)


@final
class Normal(AbstractFamily):
    """Normal distribution with `mean` and standard deviation `std`: standard normal germ, Hermite polynomials."""

    STANDARD: ClassVar[Standard] = NORMAL
    FORMS: ClassVar[dict[tuple[str, ...], Form]] = {("mean", "std"): Form(lambda mean, std: Canonical(mean, std))}

    def __init__(self, mean: Any = None, std: Any = None, *, shared_name: str | None = None):
        self.set_parameters({"mean": mean, "std": std}, shared_name)


def _beta_from_shape(alpha: Scalar, beta: Scalar, lower: Scalar, upper: Scalar) -> Canonical:
    return Canonical((lower + upper) / 2, (upper - lower) / 2, (alpha, beta))


def _beta_from_moments(mean: Scalar, std: Scalar, lower: Scalar, upper: Scalar) -> Canonical:
    centre = (mean - lower) / (upper - lower)
    total = centre * (1 - centre) * ((upper - lower) / std) ** 2 - 1
    return _beta_from_shape(centre * total, (1 - centre) * total, lower, upper)


def _beta_transport(germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
    alpha, beta = source
    below, above = special.betainc(alpha, beta, (1 + germ) / 2), special.betainc(beta, alpha, (1 - germ) / 2)
    return 2 * beta_quantile(below, above, *target) - 1


@final
class Beta(AbstractFamily):
    """Beta distribution on [lower, upper], default [0, 1].

    `Beta(alpha=2.0, beta=5.0)` or, by its moments, `Beta(mean=0.3, std=0.1)`; Jacobi polynomials.
    """

    STANDARD: ClassVar[Standard] = Standard(
        JacobiGerm,
        from_normal=lambda normal, *shape: 2 * beta_quantile(special.ndtr(normal), special.ndtr(-normal), *shape) - 1,
        transport=_beta_transport,
        anchor=lambda germ, *shape: 2 * beta_anchor((1 + germ) / 2, *shape) - 1,
        mean=lambda alpha, beta: (alpha - beta) / (alpha + beta),
        std=lambda alpha, beta: 2 * _root(alpha * beta / (alpha + beta + 1)) / (alpha + beta),
    )
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
        parameters = {"alpha": alpha, "beta": beta, "mean": mean, "std": std, "lower": lower, "upper": upper}
        self.set_parameters(parameters, shared_name)


def _root(square: Scalar) -> Scalar:
    library, square = in_library(square)
    return library.sqrt(square)


def _gamma_from_moments(mean: Scalar, std: Scalar, lower: Scalar) -> Canonical:
    return Canonical(lower, std**2 / (mean - lower), (((mean - lower) / std) ** 2,))


def _gamma_transport(germ: Float[Array, ""], source: tuple, target: tuple) -> Float[Array, ""]:
    return gamma_quantile(special.gammainc(source[0], germ), special.gammaincc(source[0], germ), *target)


@final
class Gamma(AbstractFamily):
    """Gamma distribution above `lower`, default 0.

    `Gamma(shape=4.0, scale=0.5)` or, by its moments, `Gamma(mean=2.0, std=1.0)`; Laguerre polynomials.
    """

    STANDARD: ClassVar[Standard] = Standard(
        LaguerreGerm,
        from_normal=lambda normal, shape: gamma_quantile(special.ndtr(normal), special.ndtr(-normal), shape),
        transport=_gamma_transport,
        anchor=gamma_anchor,
        mean=lambda shape: shape,
        std=_root,
    )
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
