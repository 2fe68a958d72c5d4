"""Fresh systems for a second opinion: half as they come, half from the tails, where few would come by chance.

An output may owe much of its spread to the one system in a hundred that no collocation point and none of a few random
systems resembles. Weights undo the choice (multiple importance sampling with the balance heuristic of Veach & Guibas,
1995), and no weight exceeds 2.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.ensemble import at_levels, random_levels
from aleator.uncertainty import AbstractGerm

# The depths of tails, as parts of all systems: more than 4 standard deviations of a normal germ, and the median.
_DEEPEST, _SHALLOWEST = 1e-5, 0.5


class FreshSystems(NamedTuple):
    """Germ points, and the weights with which their mean stands for all systems."""

    points: Float[np.ndarray, "fresh variables"]
    weights: Float[np.ndarray, " fresh"]


def fresh_systems(germs: Collection[AbstractGerm], count: int, generator: np.random.Generator) -> FreshSystems:
    """Half of the systems drawn at random, in the others one germ after the other in its lower or its upper tail.

    Depths within a tail are log-uniform, spread evenly over the systems of that tail.
    """
    levels = random_levels(generator, count, len(germs))
    tails = np.arange(count - count // 2) % (2 * len(germs))
    which, upper = tails // 2, tails % 2 == 1
    depths = _depths(tails, generator)
    levels[count // 2 + np.arange(len(tails)), which] = np.where(upper, 1 - depths, depths)
    drawn = np.bincount(tails, minlength=2 * len(germs)) / count
    density = count // 2 / count + _tail_density(levels) @ drawn[::2] + _tail_density(1 - levels) @ drawn[1::2]
    return FreshSystems(at_levels(germs, levels), 1 / density)


def _depths(tails: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A depth for each system, one in each of the equal parts of its tail's logarithmic range."""
    parts = np.empty(len(tails))
    for tail in np.unique(tails):
        those = np.flatnonzero(tails == tail)
        parts[those] = (np.arange(len(those)) + generator.random(len(those))) / len(those)
    return _DEEPEST * (_SHALLOWEST / _DEEPEST) ** parts


def _tail_density(depths: np.ndarray) -> np.ndarray:
    """The density of a level at a depth below the median, relative to a random one."""
    inside = (depths >= _DEEPEST) & (depths <= _SHALLOWEST)
    return np.where(inside, 1 / (np.maximum(depths, _DEEPEST) * np.log(_SHALLOWEST / _DEEPEST)), 0.0)
