"""The partition of coordinates and velocities into prescribed and integrated ones."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from aleator.mechanics._constraints import Bound, Loose
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.mechanics._places import merged


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
    bound: Bound


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
    def others(self) -> tuple[int, ...]:
        """The places of coordinates that are not prescribed."""
        return _without(self.prescribed, self.coordinates)

    @property
    def undriven(self) -> tuple[int, ...]:
        """The places of the other velocities."""
        return _without(self.driven, self.speeds)

    @property
    def unknown(self) -> tuple[int, ...]:
        """The places of torques to find."""
        return _without(self.known, self.actuators)

    @property
    def loose(self) -> Loose:
        """What follows constraints, if there are any."""
        return Loose(self.others, self.undriven)

    def merged(self, prescribed: Array, others: Array) -> Float[Array, " coordinates"]:
        """Coordinates in their order."""
        return merged(prescribed, self.prescribed, others, self.others)

    def joined(self, driven: Array, others: Array) -> Float[Array, " speeds"]:
        """Velocities in their order."""
        return merged(driven, self.driven, others, self.undriven)

    def applied(self, found: Array, known: Array) -> Float[Array, " actuators"]:
        """Torques in their order."""
        return merged(found, self.unknown, known, self.known)


def _without(places: tuple[int, ...], count: int) -> tuple[int, ...]:
    return tuple(i for i in range(count) if i not in places)
