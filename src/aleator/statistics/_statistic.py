"""`AbstractStatistic`: a number that summarises the distribution of an uncertain output; moments of one output or two.

Moments of an expansion in an orthonormal basis follow from its coefficients alone (equations 30-33, 98, 99).
"""

import abc
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, Scalar, alike, in_library, jax_array, quietly
from aleator._core.border import real
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, is_traced
from aleator.expansion import ROUNDING, AbstractBasis
from aleator.statistics._lines import AnyLines
from aleator.statistics._units import PURE, product, squared

Preparation: TypeAlias = Callable[[AbstractBasis], Pytree]
"""A hashable function from a basis to the constant arrays that a statistic needs. Equal preparations are shared."""


class AbstractStatistic(Module):
    """A statistic of an output: from an expansion's coefficients, or estimated from a sample.

    `symbol` is how it prints; a `dimensionless` statistic has no unit. One that needs more of the basis than
    orthonormality (a sample of the polynomials, their products) returns a `preparation`, which runs once, before
    compilation.
    """

    symbol: ClassVar[str]
    dimensionless: ClassVar[bool] = False
    speaks_of_one_system: ClassVar[bool] = False
    """Whether a bound on it also applies to a single system, whose value then takes its place: true for a mean or a
    quantile, false for a spread, which is zero for a single system."""
    needs_no_compiler: ClassVar[bool] = False
    """Whether `of` compiles nothing for what is known: it computes by NumPy."""

    @property
    def preparation(self) -> Preparation | None:
        """A function of the basis that gives its constants; None if it needs none."""
        return None

    @abc.abstractmethod
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        """The statistic of an expansion in an orthonormal basis; `constants` is the result of its preparation."""

    @abc.abstractmethod
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The same statistic estimated from independent samples, without an expansion."""

    def unit(self, *of: str) -> str:
        """Its unit, from those of its arguments (see `statistics/_units.py`): by default that of the first, or none."""
        return PURE if self.dimensionless else of[0]

    def text(self, inside: str) -> str:
        """As mathematics: `μ[x]`."""
        return f"{self.symbol}[{inside}]"


def a_statistic(kind: Any) -> AbstractStatistic:
    """Return a statistic unchanged. Raises `ProblemError` for anything else."""
    if isinstance(kind, AbstractStatistic):
        return kind
    remedy = " Make one of the class first." if isinstance(kind, type) else ""
    raise ProblemError(f"statistic: expected a statistic, such as one of docs/extending.md; received {kind!r}.{remedy}")


def in_blocks(
    function: Callable[[Float[Any, "entries terms"]], Any],
    coefficients: Float[Any, "terms *shape"],
    together: int,
) -> Float[Any, "..."]:
    """Apply a function of several outputs' coefficients, shape (entries, terms), to outputs of any shape.

    It gets `together` entries at a time, which bounds the memory that it needs.
    """
    library, coefficients = in_library(coefficients)
    shape = coefficients.shape[1:]
    entries = library.moveaxis(coefficients.reshape(len(coefficients), -1), 1, 0)
    count = len(entries)
    if count <= together:
        values = function(entries)
    elif library is np:
        values = np.concatenate([function(entries[first : first + together]) for first in range(0, count, together)])
    else:
        blocks = -(-count // together)
        # The last block is filled up with copies of the last entry.
        filled = jnp.pad(entries, ((0, blocks * together - count), (0, 0)), mode="edge")
        values = jax.lax.map(function, filled.reshape(blocks, together, -1))
        values = values.reshape(-1, *values.shape[2:])[:count]
    return values.reshape(*shape, *values.shape[1:])


@final
class Constants(Module):
    """The constant arrays of some statistics, prepared once.

    `scenarios`: the germ points at which limits on the worst case are imposed; None if a problem has no such limit.
    """

    preparations: tuple[Any, ...] = eqx.field(static=True)
    values: tuple[Pytree, ...]
    scenarios: Float[Array, "scenarios variables"] | None = None

    def of(self, statistic: AbstractStatistic) -> Pytree:
        """The constants of one statistic."""
        if statistic.preparation is None:
            return ()
        return self.values[self.preparations.index(statistic.preparation)]

    def for_one_of(self, entries: int) -> "Constants":
        """Those for one of so many entries of a path: tails by fewer lines."""
        each = (one.for_one_of(entries) if isinstance(one, AnyLines) else one for one in self.values)
        return replace(self, values=tuple(each))


@final
class Mean(AbstractStatistic):
    """The expected value, equation (32): the first coefficient."""

    symbol: ClassVar[str] = "μ"
    speaks_of_one_system: ClassVar[bool] = True
    needs_no_compiler: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        _, terms = in_library(coefficients)
        return alike(terms[0], coefficients)

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        return jax_array(library.mean(values, axis=0))


@final
class Variance(AbstractStatistic):
    """The variance, equation (33): the sum of squares from the second coefficient on.

    - `noisy`: whether white noise moves the output in each system: its variance there is stacked beside the output
      along a last axis, and the mean of this is added (the law of total variance).
    """

    symbol: ClassVar[str] = "Var"
    noisy: bool = eqx.field(static=True, default=False)
    needs_no_compiler: ClassVar[bool] = True

    @override
    @quietly
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        library, terms = in_library(coefficients)
        if self.noisy:
            return terms[0, ..., 1] + Variance().of(terms[..., 0], ())
        return alike(library.sum(terms[1:] ** 2, axis=0), coefficients)

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        if self.noisy:
            return Mean().of_sample(values[..., 1]) + Variance().of_sample(values[..., 0])
        # Of one value it is not a number, of which `np.var` would warn.
        return jax_array(library.sum((values - library.mean(values, axis=0)[None]) ** 2, axis=0) / (len(values) - 1))

    @override
    def text(self, inside: str) -> str:
        return super().text(inside.partition(", ")[0] if self.noisy else inside)

    @override
    def unit(self, *of: str) -> str:
        return squared(*of)


@final
class Std(AbstractStatistic):
    """The standard deviation, equation (33).

    Where the variance is zero but for rounding, as for a certain initial condition, so is the derivative: the root has
    no finite one there, and zero is the subgradient of smallest norm. `noisy`: see `Variance`.
    """

    symbol: ClassVar[str] = "σ"
    noisy: bool = eqx.field(static=True, default=False)
    needs_no_compiler: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Pytree) -> Float[Array, "*shape"]:
        library, terms = in_library(coefficients)
        mean = terms[0, ..., 0] if self.noisy else terms[0]
        mean = mean if library is np else jax.lax.stop_gradient(mean)
        return root(Variance(self.noisy).of(coefficients, constants), ROUNDING * abs(mean))

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        return root(Variance(self.noisy).of_sample(values))

    @override
    def text(self, inside: str) -> str:
        return super().text(inside.partition(", ")[0] if self.noisy else inside)


@quietly
def varies(coefficients: Float[Array, "terms *shape"]) -> Bool[Array, "*shape"]:
    """Whether an output varies beyond rounding. NaN and infinite values count as varying."""
    library, coefficients = in_library(coefficients)
    variance = library.sum(coefficients[1:] ** 2, axis=0)
    constant = (variance == 0) | (variance < ROUNDING**2 * library.sum(coefficients**2, axis=0))
    return jax_array(~constant)


@quietly
def root(square: Float[Array, "*shape"], rounding: Any = None) -> Float[Array, "*shape"]:
    """The square root, with derivative zero at zero; zero for negative numbers, which only rounding causes.

    - `rounding`: a root below this is zero too, if it is given.
    """
    # Compared such that what is not finite stays so.
    library, known = in_library(square)
    none = known <= 0
    size = library.sqrt(library.where(none, 1.0, known))
    return alike(library.where(none if rounding is None else none | (size < rounding), 0.0, size), square)


@final
class Covariance(AbstractStatistic):
    """The covariance of two outputs, stacked along the last axis: the inner product of their coefficients.

    The first coefficients, the means, are left out, as in equation (33).
    """

    symbol: ClassVar[str] = "Cov"
    needs_no_compiler: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        library, coefficients = in_library(coefficients)
        first, second = _both(coefficients[1:])
        return jax_array(library.sum(first * second, axis=0))

    @override
    @quietly
    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        first, second = _both(values - library.mean(values, axis=0)[None])
        return jax_array(library.sum(first * second, axis=0) / (len(values) - 1))

    @override
    def unit(self, *of: str) -> str:
        return product(*of)


@final
class CoefficientProduct(AbstractStatistic):
    """`Σ_j |a^j b^j|` of two outputs, stacked along the last axis: the printed form of the expected power (83).

    It depends on the basis, not on the two outputs alone, so that no sample estimates it. With a `smoothing` `s`, `|x|`
    is `sqrt(x² + s²) - s`.
    """

    symbol: ClassVar[str] = "Σ|·|"
    needs_no_compiler: ClassVar[bool] = True
    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        library, coefficients = in_library(coefficients)
        first, second = _both(coefficients)
        products, s = first * second, self.smoothing
        return jax_array(library.sum(library.sqrt(products**2 + s**2) - s if s else library.abs(products), axis=0))

    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        """NaN, because no sample estimates it."""
        return jnp.full(values.shape[1:-1], jnp.nan)

    @override
    def unit(self, *of: str) -> str:
        return product(*of)


@final
class Correlation(AbstractStatistic):
    """The correlation coefficient of two outputs, stacked along the last axis: between -1 and 1.

    It is zero, with derivative zero, if one of them does not vary.
    """

    symbol: ClassVar[str] = "Corr"
    needs_no_compiler: ClassVar[bool] = True
    dimensionless: ClassVar[bool] = True

    @override
    def of(self, coefficients: Float[Array, "terms *shape 2"], constants: Pytree) -> Float[Array, "*shape"]:
        del constants
        _, coefficients = in_library(coefficients)
        return _cosine(coefficients[1:], coefficients[0])

    @override
    def of_sample(self, values: Float[Array, "samples *shape 2"]) -> Float[Array, "*shape"]:
        library, values = in_library(values)
        mean = library.mean(values, axis=0)
        return _cosine(values - mean[None], mean * len(values) ** 0.5)


@quietly
def _cosine(vectors: Float[Array, "n *shape 2"], beside: Float[Array, "*shape 2"]) -> Float[Array, "*shape"]:
    """The cosine of the angle between two vectors; zero where one is rounding of the number beside it."""
    library, vectors, beside = in_library(vectors, beside)
    first, second = _both(vectors)
    # One root each, because the product of both squares overflows earlier.
    _, *sizes = in_library(*(root(library.sum(one**2, axis=0)) for one in (first, second)))
    rounding = ROUNDING * abs(beside)
    constant = (sizes[0] <= rounding[..., 0]) | (sizes[1] <= rounding[..., 1])
    size = library.where(constant, 1.0, sizes[0] * sizes[1])
    return jax_array(library.where(constant, 0.0, library.sum(first * second, axis=0) / size))


def _both(stacked: Float[Array, "n *shape outputs"]) -> tuple[Float[Array, "n *shape"], Float[Array, "n *shape"]]:
    if stacked.ndim < 2 or stacked.shape[-1] != 2:
        raise ProblemError(
            "Covariance and Correlation are of two outputs, stacked along the last axis: expected the shape "
            f"(terms, ..., 2); received {stacked.shape}."
        )
    return stacked[..., 0], stacked[..., 1]


def level_given(kind: str, level: Any) -> Scalar:
    """A probability level, strictly between 0 and 1. Raises `ProblemError` for any other value."""
    number = number_given(kind, "level", level)
    if not is_traced(number) and not 0 < float(number) < 1:
        raise ProblemError(
            f"{kind}: expected a level between 0 and 1, such as 0.99; received {level!r}. The ends of the distribution "
            "are Supremum and Infimum."
        )
    return number


def number_given(kind: str, name: str, value: Any) -> Scalar:
    """A finite number; an array of JAX, traced or not, stays one. Raises `ProblemError` for anything else."""
    if isinstance(value, jax.Array) and value.ndim == 0 and (is_traced(value) or np.isfinite(value)):
        return value
    return real(f"{kind}: {name}", value, "one finite number")
