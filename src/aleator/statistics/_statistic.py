"""`AbstractStatistic`: a number that summarises the distribution of an uncertain output."""

import abc
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator.expansion import Basis

Preparation: TypeAlias = Callable[[Basis], Pytree]
"""A hashable function from a basis to the constant arrays that a statistic needs. Equal preparations are shared."""


class AbstractStatistic(Module):
    """A statistic of an output: from an expansion's coefficients, or estimated from a sample.

    `symbol` is how it prints. A statistic that needs more of the basis than orthonormality (a sample of the
    polynomials, their products) returns a `preparation`, which runs once, before compilation.
    """

    symbol: ClassVar[str]

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

    @property
    def speaks_of_one_system(self) -> bool:
        """Whether a bound on it also applies to a single system, whose value then takes its place.

        True for a mean or a quantile; false for a spread, which is zero for a single system.
        """
        return False

    def unit(self, *of: str) -> str:
        """Its unit, from those of its arguments (see `_core.units`): by default that of the first."""
        return of[0]

    def text(self, inside: str) -> str:
        """As mathematics: `μ[x]`."""
        return f"{self.symbol}[{inside}]"


def a_statistic(given: Any) -> AbstractStatistic:
    """Return a statistic unchanged. Raises `ProblemError` for anything else."""
    if isinstance(given, AbstractStatistic):
        return given
    made = " Make one of the class first." if isinstance(given, type) else ""
    raise ProblemError(f"statistic: expected a statistic, such as one of docs/extending.md; received {given!r}.{made}")


def entry_by_entry(
    one: Callable[[Float[Array, " terms"]], Array], coefficients: Float[Array, "terms *shape"], together: int
) -> Float[Array, "..."]:
    """Apply a function of one output's coefficients to each entry of outputs of any shape, in blocks of `together`."""
    return in_blocks(jax.vmap(one), coefficients, together)


def in_blocks(
    some: Callable[[Float[Array, "entries terms"]], Array], coefficients: Float[Array, "terms *shape"], together: int
) -> Float[Array, "..."]:
    """Apply a function of several outputs' coefficients, shape (entries, terms), to outputs of any shape.

    It gets `together` entries at a time, which bounds the memory that it needs.
    """
    shape = coefficients.shape[1:]
    entries = jnp.moveaxis(coefficients.reshape(len(coefficients), -1), 1, 0)
    count = len(entries)
    if count <= together:
        values = some(entries)
    else:
        blocks = -(-count // together)
        # The last block is filled up with copies of the last entry.
        filled = jnp.pad(entries, ((0, blocks * together - count), (0, 0)), mode="edge")
        values = jax.lax.map(some, filled.reshape(blocks, together, -1))
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


def prepare(statistics: Iterable[AbstractStatistic], basis: Basis) -> Constants:
    """The constants of all statistics; each preparation runs once."""
    needed = (statistic.preparation for statistic in statistics)
    preparations = tuple(dict.fromkeys(one for one in needed if one is not None))
    return Constants(preparations, tuple(one(basis) for one in preparations))
