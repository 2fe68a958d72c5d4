"""Supremum and infimum of an output over the support (dissertation, equation 88)."""

from collections.abc import Callable
from typing import ClassVar, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator.statistics._branch_and_bound import bound, difficulty
from aleator.statistics._enclosure import Enclosure, enclosure
from aleator.statistics._local_search import climbed
from aleator.statistics._statistic import AbstractStatistic, in_blocks

# Entries per block: few in a search, because it goes on until the last of them is done.
_TOGETHER = 16
_EASY_TOGETHER = 64


@final
class Supremum(AbstractStatistic):
    """An upper bound of the expansion on the support of bounded distributions (dissertation, equation 88).

    It bounds the expansion, not the model, whose values may exceed it where the expansion errs. It is never below the
    supremum of the expansion, and above it by at most 1e-4 of the range of the Bernstein coefficients, unless the
    search reaches its limit on boxes; `attained` tells the gap. Its derivative is that of the active coefficient.
    """

    symbol: ClassVar[str] = "sup"

    @property
    @override
    def preparation(self) -> Callable[..., Enclosure]:
        return enclosure

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Enclosure) -> Float[Array, "*shape"]:
        return _searched(bound, coefficients, constants)

    def attained(self, coefficients: Float[Array, "terms *shape"], constants: Enclosure) -> Float[Array, "*shape"]:
        """A value of the expansion, found by local search: the supremum lies between it and the bound."""
        return _searched(climbed, coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The largest value of the sample, which is never more than the supremum."""
        return jnp.max(values, axis=0)

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True


@final
class Infimum(AbstractStatistic):
    """A lower bound of the expansion on the support of bounded distributions, as `Supremum` is an upper one."""

    symbol: ClassVar[str] = "inf"

    @property
    @override
    def preparation(self) -> Callable[..., Enclosure]:
        return enclosure

    @override
    def of(self, coefficients: Float[Array, "terms *shape"], constants: Enclosure) -> Float[Array, "*shape"]:
        return -Supremum().of(-coefficients, constants)

    def attained(self, coefficients: Float[Array, "terms *shape"], constants: Enclosure) -> Float[Array, "*shape"]:
        """The infimum lies between the bound and this value."""
        return -Supremum().attained(-coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The smallest value of the sample, which is never less than the infimum."""
        return jnp.min(values, axis=0)

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True


def _searched(
    search: Callable[[Array, Enclosure], Array], coefficients: Float[Array, "terms *shape"], form: Enclosure
) -> Float[Array, "*shape"]:
    """Search for all entries, grouped by difficulty: a group takes as long as its hardest entry."""
    if not form.shape:
        return coefficients[0]
    flat = coefficients.reshape(len(coefficients), -1)
    if flat.shape[1] <= _TOGETHER:
        return in_blocks(lambda terms: search(terms, form), coefficients, _TOGETHER)
    fixed = jax.lax.stop_gradient(flat)
    order = jnp.argsort(in_blocks(lambda terms: difficulty(terms, form), fixed, _EASY_TOGETHER))
    found = in_blocks(lambda terms: search(terms, form), flat[:, order], _TOGETHER)
    return jnp.zeros(len(found)).at[order].set(found).reshape(coefficients.shape[1:])
