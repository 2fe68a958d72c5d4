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

# How many entries are worked on at once: few in a search, for it ends with the last of them.
_TOGETHER = 16
_EASY_TOGETHER = 64


@final
class Supremum(AbstractStatistic):
    """The largest value that the expansion takes anywhere on the support of bounded distributions, bounded from above.

    It bounds the expansion, not the model, which may exceed it where the expansion misses something. It is at least the
    supremum of the expansion. Where the search ends before its limit on boxes, it is above it by at most 1e-4 of the
    range of the Bernstein coefficients; `attained` tells the gap. Its derivative is that of the active coefficient.
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
        """A value that the expansion takes, found by local search: the supremum lies between it and the bound."""
        return _searched(climbed, coefficients, constants)

    @override
    def of_sample(self, values: Float[Array, "samples *shape"]) -> Float[Array, "*shape"]:
        """The largest of the sample, which is never more than the supremum."""
        return jnp.max(values, axis=0)

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True


@final
class Infimum(AbstractStatistic):
    """The smallest value that the expansion takes anywhere on the support, bounded from below. See `Supremum`."""

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
        """The smallest of the sample, which is never less than the infimum."""
        return jnp.min(values, axis=0)

    @property
    @override
    def speaks_of_one_system(self) -> bool:
        return True


def _searched(
    search: Callable[[Array, Enclosure], Array], coefficients: Float[Array, "terms *shape"], form: Enclosure
) -> Float[Array, "*shape"]:
    """A search for each entry, easy ones with easy ones: entries that are searched together end with the hardest."""
    if not form.shape:
        return coefficients[0]
    flat = coefficients.reshape(len(coefficients), -1)
    fixed = jax.lax.stop_gradient(flat)
    order = jnp.argsort(in_blocks(lambda terms: difficulty(terms, form), fixed, _EASY_TOGETHER))
    found = in_blocks(lambda terms: search(terms, form), flat[:, order], _TOGETHER)
    return jnp.zeros(len(found)).at[order].set(found).reshape(coefficients.shape[1:])
