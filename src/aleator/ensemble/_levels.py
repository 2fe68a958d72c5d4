"""Germ points at given or random probability levels."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float

from aleator.uncertainty import AbstractGerm


def at_levels(
    germs: Collection[AbstractGerm], levels: Float[np.ndarray, "n variables"]
) -> Float[np.ndarray, "n variables"]:
    """Germ points at given probability levels between 0 and 1, one column per germ variable."""
    columns = [germ.quantile(levels[:, i]) for i, germ in enumerate(germs)]
    return np.stack(columns, axis=1) if columns else levels


def random_levels(generator: np.random.Generator, *shape: int) -> Float[np.ndarray, "..."]:
    """Independent probability levels, never 0 or 1, where unbounded distributions are infinite."""
    # The generator excludes its upper end, but not its lower one.
    return generator.uniform(np.finfo(float).tiny, 1.0, shape)


def draw(
    germs: Collection[AbstractGerm], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "count variables"]:
    """Independent random germ points."""
    return at_levels(germs, random_levels(generator, count, len(germs)))


def drawn_from(
    germs: Collection[AbstractGerm], seed: int, first: int, count: int
) -> Float[np.ndarray, "count variables"]:
    """Those of the random germ points of a seed that follow the `first` ones: all of them together are one `draw`."""
    bits = np.random.PCG64(seed)
    # One state of the generator for each number.
    bits.advance(first * len(germs))
    return draw(germs, count, np.random.Generator(bits))
