"""Statistics that are evaluated together, because a loop for all of them takes as long to compile as one for each."""

from collections.abc import Sequence

import jax
from jaxtyping import Array, Float

from aleator.statistics._statistic import AbstractStatistic, Constants
from aleator.statistics._tails import AbstractTail, tails_together


def together(
    asked: Sequence[tuple[AbstractStatistic, Float[Array, "terms ..."]]], constants: Constants
) -> list[Float[Array, "..."] | None]:
    """The statistics among those asked for that share a loop with another one; None for the rest."""
    alike: dict[tuple, list[int]] = {}
    for i, (kind, coefficients) in enumerate(asked):
        if isinstance(kind, AbstractTail):
            alike.setdefault((jax.tree.structure(kind), coefficients.shape), []).append(i)
    found: list[Array | None] = [None] * len(asked)
    for places in alike.values():
        if len(places) > 1:
            kinds, terms = zip(*(asked[i] for i in places), strict=True)
            for i, values in zip(places, tails_together(kinds, terms, constants.of(kinds[0])), strict=True):
                found[i] = values
    return found
