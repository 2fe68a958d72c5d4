"""Entries of arrays at known places, by slices: gathers and scatters, and their derivatives, take XLA far longer."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.mechanics._spatial import Numbers, library


def taken(array: Float[Numbers, "n ..."], places: Sequence[int]) -> Float[Numbers, "places ..."]:
    """The entries at some places along the first axis, in the order of the places."""
    if tuple(places) == tuple(range(len(array))):
        return array
    parts = [array[first:last] for first, last in _runs(places)]
    return parts[0] if len(parts) == 1 else library(array).concatenate([array[:0], *parts])


def block(M: Float[Array, "m n"], rows: Sequence[int], columns: Sequence[int]) -> Float[Array, "rows columns"]:
    """The entries of a matrix in some rows and columns."""
    return taken(taken(M, rows).T, columns).T


def spread(values: Float[Array, "places ..."], places: Sequence[int], count: int) -> Float[Array, "count ..."]:
    """Values at some places along the first axis of so many; zero elsewhere."""
    others = [i for i in range(count) if i not in places]
    return merged(values, places, jnp.zeros((len(others), *values.shape[1:])), others)


def merged(
    first: Float[Array, "some ..."], places: Sequence[int], second: Float[Array, "others ..."], others: Sequence[int]
) -> Float[Array, "n ..."]:
    """Two parts of an array, each at its places along the first axis."""
    listed = [*places, *others]
    return taken(jnp.concatenate([first, second]), [listed.index(i) for i in range(len(listed))])


def _runs(places: Sequence[int]) -> Iterator[tuple[Any, Any]]:
    """Ranges of places that follow one another, from the first to before the last."""
    found = [int(place) for place in places]
    while found:
        count = next((i for i in range(1, len(found)) if found[i] != found[0] + i), len(found))
        yield found[0], found[0] + count
        found = found[count:]
