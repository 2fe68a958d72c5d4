"""The partition of coordinates and velocities into prescribed and integrated ones."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array


class Prescribed(NamedTuple):
    """The prescribed motion and the known torques at one instant (or their rates)."""

    position: Array
    velocity: Array
    acceleration: Array
    known: Array


class Solved(NamedTuple):
    """The complete motion at one instant."""

    q: Array
    v: Array
    v_dot: Array
    torque: Array


def block(M: Any, rows: Any, columns: Any) -> Any:
    """The entries of a matrix in some rows and columns."""
    return M[np.asarray(rows, dtype=int)][:, np.asarray(columns, dtype=int)]


def order(places: tuple[int, ...]) -> np.ndarray:
    """The permutation that puts entries listed by their places in order."""
    return np.argsort(np.array(places, dtype=int))
