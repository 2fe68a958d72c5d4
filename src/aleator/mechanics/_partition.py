"""The partition of coordinates and velocities into prescribed and integrated ones."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator.mechanics._constraints import Loose
from aleator.mechanics._mechanical import AbstractMechanical


class Prescribed(NamedTuple):
    """The prescribed motion and the known torques at one instant (or their rates)."""

    position: Array
    velocity: Array
    acceleration: Array
    known: Array


class Solved(NamedTuple):
    """The complete motion at one instant, and whether its constraints could be satisfied."""

    q: Array
    v: Array
    v_dot: Array
    torque: Array
    multipliers: Array
    kept: Any


class Partition(NamedTuple):
    """The places of prescribed coordinates, of the velocities that these drive, and of known torques; of how many."""

    prescribed: tuple[int, ...]
    driven: tuple[int, ...]
    known: tuple[int, ...]
    coordinates: int
    speeds: int
    actuators: int

    @classmethod
    def of(
        cls, model: AbstractMechanical, prescribed: tuple[int, ...], driven: tuple[int, ...], known: tuple[int, ...]
    ) -> "Partition":
        """The partition of a model's coordinates, velocities and torques."""
        return cls(prescribed, driven, known, len(model.coordinates), len(model.speeds), len(model.actuators))

    @property
    def others(self) -> Int[np.ndarray, " others"]:
        """The places of coordinates that are not prescribed."""
        return _without(self.prescribed, self.coordinates)

    @property
    def undriven(self) -> Int[np.ndarray, " undriven"]:
        """The places of the other velocities."""
        return _without(self.driven, self.speeds)

    @property
    def unknown(self) -> Int[np.ndarray, " unknown"]:
        """The places of torques to find."""
        return _without(self.known, self.actuators)

    @property
    def loose(self) -> Loose:
        """What follows constraints, if there are any."""
        return Loose(tuple(map(int, self.others)), tuple(map(int, self.undriven)))

    def merged(self, prescribed: Array, others: Array) -> Float[Array, " coordinates"]:
        """Coordinates in their order."""
        return jnp.concatenate([prescribed, others])[_order(self.prescribed, self.others)]

    def joined(self, driven: Array, others: Array) -> Float[Array, " speeds"]:
        """Velocities in their order."""
        return jnp.concatenate([driven, others])[_order(self.driven, self.undriven)]

    def applied(self, found: Array, known: Array) -> Float[Array, " actuators"]:
        """Torques in their order."""
        return jnp.concatenate([found, known])[_order(self.unknown, self.known)]


def block(M: Any, rows: Any, columns: Any) -> Any:
    """The entries of a matrix in some rows and columns."""
    return M[np.asarray(rows, dtype=int)][:, np.asarray(columns, dtype=int)]


def _without(places: tuple[int, ...], count: int) -> np.ndarray:
    return np.array([i for i in range(count) if i not in places], dtype=int)


def _order(*places: Any) -> np.ndarray:
    """Which entry of what is listed by places comes first, second, and so on."""
    return np.argsort(np.concatenate([np.asarray(one, dtype=int) for one in places]))
