"""The sparsity of constraints' derivatives: rows of splines depend on few decisions each."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

# How many points near the start show which derivatives are zero everywhere, and how far away they are.
_NEARBY, _DISTANCE = 3, 0.1


def nearby(
    start: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    size: Float[np.ndarray, " n"],
) -> list[Float[np.ndarray, " n"]]:
    """Decisions near the start, by a part of their typical magnitudes; few derivatives vanish at all of them."""
    steps = _DISTANCE * np.random.default_rng(0).uniform(-1, 1, (_NEARBY, len(start)))
    return list(np.clip(start + size * steps, lower, upper))


def sparsity_of(
    nonzero: Bool[np.ndarray, "rows n"], paths: Sequence[slice], instants: int
) -> Bool[np.ndarray, "rows n"]:
    """The derivatives that may be nonzero, from those that are nonzero at some decisions.

    A constraint on a path, whose rows are in `paths`, counts as depending on a decision at an instant if it did so at
    any instant, and if any such constraint did so at this one: so interactions of bodies that are near each other only
    for a while count wherever they may occur. Other constraints may depend on everything.
    """
    sparsity = np.ones_like(nonzero)
    felt = np.zeros((instants, nonzero.shape[1]), dtype=bool)
    for where in paths:
        felt |= nonzero[where].reshape(instants, -1, nonzero.shape[1]).any(axis=1)
    for where in paths:
        block = nonzero[where]
        sparsity[where] = np.repeat(felt, len(block) // instants, axis=0) & block.any(axis=0)
    return sparsity
